"""Optional libraries: imported when needed; the error says how to install a missing one."""

from importlib import import_module
from importlib.util import find_spec
from typing import Any

from tricycle_core.errors import ReportError

EXTRAS = {
    "matplotlib": "plots",
    "plotly": "reports",
    "jinja2": "reports",
    "rclpy": "ros",
    "distributed": "dask",
    "pyarrow": "parquet",
    "mujoco": "mujoco",
    "vehiclemodels": "commonroad",
    "fmpy": "fmi",
    "fsspec": "remote",
    "upath": "remote",
    "s3fs": "remote",
    "aiohttp": "remote",
    "paramiko": "remote",
}
"""Extra of this distribution that brings a library."""


def optional(module: str, what: str) -> Any:
    """Import and return a library that need not be installed.

    Parameters
    ----------
    module : str
        Name of the module to import.
    what : str
        What needs the library, for the message.

    Raises
    ------
    ReportError
        If it is not installed; the message says how to get it.
    """
    try:
        return import_module(module)
    except ModuleNotFoundError as error:
        if error.name != module.partition(".")[0]:
            raise
        raise ReportError(missing(error.name, what)) from error


def check_installed(module: str, what: str) -> None:
    """Raise if a library is not installed, before work that needs it at its end.

    Parameters
    ----------
    module : str
        Name of a module that is imported later.
    what : str
        What needs the library, for the message.

    Raises
    ------
    ReportError
        If it is not installed; the message says how to get it.
    """
    if find_spec(module) is None:
        raise ReportError(missing(module, what))


def missing(package: str, what: str) -> str:
    """Return the message about a library that is not installed, and how to get it.

    Parameters
    ----------
    package : str
        Name by which the library is imported.
    what : str
        What needs the library.
    """
    extra = EXTRAS.get(package)
    source = f"'tricycle-excitation[{extra}]'" if extra else package
    return f"{what} needs {package}: pip install {source}"


def own_axes() -> Any:
    """Return the axes of a new figure, which a notebook shows.

    Raises
    ------
    ReportError
        If matplotlib is not installed.
    """
    return optional("matplotlib.pyplot", "plot").subplots(layout="constrained")[1]
