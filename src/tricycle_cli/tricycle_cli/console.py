"""Consoles on which the commands print."""

from __future__ import annotations

from typing import TYPE_CHECKING, TextIO

if TYPE_CHECKING:
    from rich.console import Console


def plain_console(
    *,
    stderr: bool = False,
    file: TextIO | None = None,
    width: int | None = None,
    highlight: bool = True,
) -> Console:
    """Return a console that prints text as it is: `[left]` and `:car:` are not markup.

    Parameters
    ----------
    stderr : bool
        Whether it prints to standard error.
    file : TextIO, optional
        File that it prints to instead.
    width : int, optional
        Width of its lines [characters]; default: that of the terminal.
    highlight : bool
        Whether numbers and paths are coloured.
    """
    from rich.console import Console

    class PipedConsole(Console):
        """Leaves a closed pipe to `main`, which ends with one status for every command."""

        def on_broken_pipe(self) -> None:
            raise BrokenPipeError

    return PipedConsole(
        stderr=stderr, file=file, width=width, highlight=highlight, markup=False, emoji=False
    )
