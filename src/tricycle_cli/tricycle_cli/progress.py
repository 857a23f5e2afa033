"""A progress bar on stderr, with the time left."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

Report = Callable[[int, int], None]  # (done, total)


@contextmanager
def progress_bar(description: str) -> Iterator[Report]:
    """Show a progress bar on stderr while the block runs.

    Parameters
    ----------
    description
        What is being done, at the left of the bar.

    Yields
    ------
    report
        `report(done, total)` moves the bar; it may be called from any thread.
    """
    with Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.completed:.0f}/{task.total:.0f}"),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
        console=Console(stderr=True),
    ) as progress:
        task = progress.add_task(description, total=1)
        yield lambda done, total: progress.update(task, completed=done, total=total)
