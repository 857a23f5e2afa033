"""Recovery of torn and damaged bags."""

from contextlib import ExitStack
from itertools import chain
from pathlib import Path
from typing import NamedTuple

from trajectory_recorder.bag.conversion import common_metadata
from trajectory_recorder.bag.location import check_apart
from trajectory_recorder.bag.reader import BagReader
from trajectory_recorder.bag.records import LOST
from trajectory_recorder.bag.writer import BagWriter, whole_or_none
from tricycle_core.errors import BagError
from tricycle_core.quantities import Progress


class Recovery(NamedTuple):
    """Result of recovering a bag.

    Attributes
    ----------
    messages : int
        Number of messages recovered.
    damage : tuple of BagError
        One error for each chunk, torn end of a file, and file of a split bag, that was left out.
    complete : bool
        Whether the new bag is whole: nothing was left out, and the old one was `complete`.
    attachments : int
        Number of files in the old bag, which are not copied.
    """

    messages: int
    damage: tuple[BagError, ...]
    complete: bool
    attachments: int


def recover(bag: Path, output: Path, *, progress: Progress | None = None) -> Recovery:
    """Copy what is readable of a bag to a new one that any reader opens.

    Damaged chunks, torn ends of files, and damaged files of a split bag, are left out. The metadata
    of the new bag say so, also where a file is missing; it is not whole then.

    `BagReader` reads torn bags as they are; this is for other readers, which want the summary that
    a process killed within a write did not finish, and for bags damaged later.

    Parameters
    ----------
    bag : Path
        rosbag2 directory or file.
    output : Path
        rosbag2 directory to create.
    progress : callable, optional
        Called with the number of messages copied and in all.

    Raises
    ------
    BagError
        If nothing can be read, or the output exists or is in that bag.
    """
    damage: list[BagError] = []
    with ExitStack() as stack:
        reader = stack.enter_context(BagReader(bag, damaged=damage.append))
        check_apart(output, bag)
        messages = reader.messages()
        first = next(messages, None)
        if first is None:
            raise BagError(f"{bag}: no message can be read")
        new = BagWriter(output, metadata=common_metadata([reader]))
        writer = stack.enter_context(whole_or_none(new))
        ids = {name: writer.add_topic(topic) for name, topic in reader.topics.items()}
        total = sum(topic.count for topic in reader.topics.values())
        for done, message in enumerate(chain([first], messages), start=1):
            writer.write(ids[message.topic], message.stamp, message.data, message.published)
            if progress is not None and (done % 1000 == 0 or done == total):
                progress(done, total)
        if damage:
            lost = f"damaged parts of {bag.name}: {len(damage)}"
            known = writer.metadata.get(LOST)
            writer.metadata[LOST] = f"{known}; {lost}" if known else lost
        complete = reader.complete and not damage
        return Recovery(writer.messages, tuple(damage), complete, reader.attachments)
