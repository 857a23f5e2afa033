"""metadata.yaml of a rosbag2 directory, and the YAML inside of MCAP records."""

from pathlib import Path
from typing import Any

import yaml

from tricycle_core.documents import read_bounded
from tricycle_core.errors import BagError, message_of

NAME = "metadata.yaml"
VERSION = 9  # of the format, that of ROS 2 Jazzy
MAX_BYTES = 16_000_000  # of the file; a bag of thousands of files has a fifth

# those in C are tens of times faster; they are there where libyaml was when PyYAML was built
_Dumper = getattr(yaml, "CSafeDumper", yaml.SafeDumper)


class _Loader(getattr(yaml, "CSafeLoader", yaml.SafeLoader)):  # type: ignore[misc]
    """YAML loader without merge keys, with which a small file can make an enormous document."""

    def flatten_mapping(self, node: yaml.MappingNode) -> None:
        """Leave `<<` as it stands; it is then refused."""


def load_yaml(text: str | bytes) -> Any:
    """Return the values of a YAML text from an untrusted file.

    Parameters
    ----------
    text : str or bytes
        Text of one YAML document.

    Raises
    ------
    yaml.YAMLError
        If the text is not such a document.
    """
    return yaml.load(text, Loader=_Loader)  # noqa: S506 - a safe loader


def dump_yaml(value: object) -> str:
    """Return values as YAML, in the order of their keys.

    Parameters
    ----------
    value : dict, list, str, int, float, bool or None
        Value of plain types throughout.
    """
    return str(yaml.dump(value, Dumper=_Dumper, sort_keys=False)).strip()


def read_metadata(bag: Path) -> dict[str, Any]:
    """Return the content of metadata.yaml; empty if it is missing, as after a crash of rosbag2.

    Parameters
    ----------
    bag : Path
        The bag, a rosbag2 directory.

    Raises
    ------
    BagError
        If it is damaged, or names files outside of the bag.
    """
    path = bag / NAME
    if not path.exists():
        return {}
    return parse_metadata(
        read_bounded(path, MAX_BYTES, "a rosbag2 metadata file", BagError), str(path)
    )


def parse_metadata(text: bytes, place: str) -> dict[str, Any]:
    """Return the content of metadata.yaml.

    Parameters
    ----------
    text : bytes
        Content of the file.
    place : str
        Path of the file, for the message.

    Raises
    ------
    BagError
        If it is damaged, or names files outside of the bag.
    """
    try:
        information = dict(load_yaml(text)["rosbag2_bagfile_information"])
        files = [Path(name) for name in information.get("relative_file_paths") or []]
    except (yaml.YAMLError, KeyError, TypeError, ValueError, RecursionError) as error:
        raise BagError(f"{place} is not a rosbag2 metadata file: {message_of(error)}") from error
    if any(file.name != str(file) or file.name == ".." for file in files):
        raise BagError(f"{place} names files outside of the bag")
    return information


def write_metadata(bag: Path, information: dict[str, Any]) -> None:
    """Write metadata.yaml; a reader, or a process that is killed, finds the old text or the new.

    Parameters
    ----------
    bag : Path
        The bag, a rosbag2 directory.
    information : dict
        Entries of the format besides its version.
    """
    text = dump_yaml({"rosbag2_bagfile_information": {"version": VERSION, **information}})
    new = bag / f".{NAME}.new"  # not `write_whole`: a folder that was removed must stay so
    try:
        new.write_text(text, encoding="utf-8")
        new.replace(bag / NAME)
    finally:
        new.unlink(missing_ok=True)  # as the disk is full
