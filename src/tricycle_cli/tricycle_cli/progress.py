"""A progress bar on stderr, with the time left."""

from collections.abc import Iterator
from contextlib import contextmanager

from tricycle_cli.console import plain_console
from tricycle_core.quantities import Progress

REST = 40  # characters of a line for bar, count and times


@contextmanager
def progress_bar(description: str) -> Iterator[Progress]:
    """Show a progress bar on stderr while the block runs.

    Parameters
    ----------
    description : str
        Text at the left of the bar; shortened where the line has no room for it.

    Yields
    ------
    report : callable
        `report(done, total)` moves the bar; it may be called from any thread.
    """
    from rich import progress
    from rich.table import Column

    console = plain_console(stderr=True)
    if len(description) > (room := max(10, console.width - REST)):
        description = f"{description[: room - 1]}…"
    with progress.Progress(
        progress.TextColumn("{task.description}", markup=False),
        progress.BarColumn(),
        progress.TextColumn("{task.completed:.0f}/{task.total:.0f}"),
        progress.TimeElapsedColumn(table_column=Column(no_wrap=True)),  # the bar shrinks first
        progress.TextColumn("left"),
        progress.TimeRemainingColumn(table_column=Column(no_wrap=True)),
        console=console,
    ) as bar:
        task = bar.add_task(description, total=1)
        try:
            yield lambda done, total: bar.update(task, completed=done, total=total)
        except BaseException:
            bar.live.transient = True  # what is said of the error stands alone
            console.quiet = not console.is_interactive  # rich ends the bar with an empty line there
            raise
        # what took fewer steps than it might have is done, and nothing is left
        done = bar.tasks[0].completed or 1
        bar.update(task, completed=done, total=done)
