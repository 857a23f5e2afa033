"""The exceptions of all packages, and their messages in one line.

::

    ExcitationError
    ├── VehicleError         a vehicle file, or a value of a vehicle
    ├── PlantError           what the boards drive cannot be had, or has failed
    ├── CommandsError        a table of commands
    ├── LinkError            a by-wire link, a serial port, a message that cannot be sent
    ├── DesignError          a sensitivity analysis, a design or a study
    ├── PlanError            a maneuver family, a request or a file of a plan
    ├── BagError             a bag
    ├── JudgeError           a recorded drive that cannot be judged
    ├── IdentificationError  drives from which nothing can be identified
    ├── NodeError            a node that did not start, answer or do as it was asked
    └── ReportError          a folder of results

    InfeasibleManeuver       outcome of a simulation, not a mistake
"""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches

LISTED, CUT = 500, 100
"""Length up to which a message lists all known names, and length of a longer list [characters]."""


class ExcitationError(ValueError):
    """A mistake that the user can correct; the message says where, what, and what is right."""


class VehicleError(ExcitationError):
    """A vehicle file or a vehicle's value is wrong; the message names the place."""


class PlantError(ExcitationError):
    """A simulated plant (what the boards drive) is unknown, cannot be made, or has failed."""


class CommandsError(ExcitationError):
    """Commands cannot be used; the message names row and column."""


class LinkError(ExcitationError):
    """A by-wire link cannot do what it was asked to do."""


class DesignError(ExcitationError):
    """A sensitivity analysis or a design cannot be made as asked."""


class PlanError(ExcitationError):
    """A plan cannot be made, read or driven as asked."""


class BagError(ExcitationError):
    """A bag cannot be written, read or repaired."""


class JudgeError(ExcitationError):
    """A recorded drive cannot be judged."""


class IdentificationError(ExcitationError):
    """Parameters cannot be identified from these drives."""


class NodeError(ExcitationError):
    """A node did not start, did not answer, or did not do what it was asked."""


class ReportError(ExcitationError):
    """A folder holds no results that can be reported."""


class InfeasibleManeuver(Exception):  # noqa: N818  (an outcome of a simulation, not a mistake)
    """Raised by ``f(x, P)`` when the maneuver x cannot be driven, whatever the parameters.

    Its argument is the reason, e.g. ``"steering saturates at 3.2 s"``.
    """


def message_of(error: BaseException) -> str:
    """Return an error's message in one printable line; without the error number of the system.

    Parameters
    ----------
    error : BaseException
        Error caused by a mistake of the user.

    Examples
    --------
    >>> message_of(FileNotFoundError(2, "No such file or directory", "plan.json"))
    'plan.json: No such file or directory'
    """
    text = str(error)
    if isinstance(error, OSError) and error.strerror and text.startswith("[Errno"):
        folder = isinstance(error, IsADirectoryError)
        text = "is a folder; a file is needed" if folder else error.strerror
        text = f"{error.filename}: {text}" if error.filename else text
    text = " ".join(line.strip() for line in text.splitlines())
    # what files say of themselves may hold terminal escapes
    return "".join(c if c.isprintable() else " " for c in text)


def naming(error: BaseException, path: object) -> str:
    """Return an error's message in one line that names a file.

    Parameters
    ----------
    error : BaseException
        Error caused by a mistake of the user.
    path : object
        Path of the file; it is put first unless the message contains it.
    """
    message = message_of(error)
    return message if str(path) in message else f"{path}: {message}"


def did_you_mean(name: object, known: Iterable[object]) -> str:
    """Return a question with the known name that is closest to a misspelt one; empty if none is.

    Parameters
    ----------
    name : object
        Misspelt name.
    known : iterable of object
        Known names.
    """
    bare = {str(one).lstrip("-"): one for one in known}  # that both are options is no likeness
    close = get_close_matches(str(name).lstrip("-"), bare, 1)
    return f"did you mean {bare[close[0]]}?" if close else ""


def hint(name: object, known: Iterable[object]) -> str:
    """Return the end of a message about an unknown name: the closest known one, or all of them.

    Parameters
    ----------
    name : object
        Unknown name.
    known : iterable of object
        Known names; of more than fit into `LISTED` characters only the first are listed.

    Examples
    --------
    >>> hint("yawrate", ["speed", "yaw_rate"])
    'did you mean yaw_rate?'
    >>> hint("roll", ["speed", "yaw_rate"])
    'there are: speed, yaw_rate'
    """
    names = [str(one) for one in known]
    listed = ", ".join(names)
    if len(listed) > LISTED:
        listed = f"{listed[:CUT].rpartition(', ')[0] or listed[:CUT]}, …"
    return did_you_mean(name, names) or f"there are: {listed}"
