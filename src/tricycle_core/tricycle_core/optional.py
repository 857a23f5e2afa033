"""Libraries that only some results need: imported when asked for, missed in one line."""

from importlib import import_module
from typing import Any

from tricycle_core.errors import ReportError


def optional(module: str, what: str) -> Any:
    """Return a library that need not be installed.

    Parameters
    ----------
    module : str
        To be imported.
    what : str
        That needs it.

    Raises
    ------
    ReportError
        If it is not installed; says how to get it.
    """
    try:
        return import_module(module)
    except ModuleNotFoundError as error:
        package = module.partition(".")[0]
        if error.name != package:
            raise
        raise ReportError(f"{what} needs {package}: pip install {package}") from error


def own_axes() -> Any:
    """Return the axes of a new figure, which a notebook shows.

    Raises
    ------
    ReportError
        If matplotlib is not installed.
    """
    return optional("matplotlib.pyplot", "plot").subplots(layout="constrained")[1]
