"""Location of a bag: a path of this computer, or a URL."""

import glob
import re
from importlib import import_module
from pathlib import Path
from typing import Any, cast

from tricycle_core.errors import BagError
from tricycle_core.optional import EXTRAS, missing

TIMEOUT = 30.0
"""Seconds within which a server connects, and sends something of what it was asked for."""


def bag_path(text: str) -> Path:
    """Return where a bag is.

    Parameters
    ----------
    text : str
        Path, or URL of a file system that `fsspec` knows: ``s3://``, ``sftp://``, ``https://``, ...

    Returns
    -------
    path : Path
        Path, or for a URL an object of `upath`, which has the methods of a path.

    Raises
    ------
    BagError
        If the URL holds a password or a signature, its file system is unknown, or what reads it is
        not installed.

    Examples
    --------
    >>> bag_path("bags/circle").name
    'circle'
    """
    if not (scheme := scheme_of(text)):
        return Path(text)
    text = text.rstrip("/")
    _check_no_secret(scheme, text.partition("://")[2])
    try:
        from upath import UPath

        return cast("Path", UPath(text, **_options(scheme)))
    except ModuleNotFoundError as error:
        raise _not_installed(text, error) from error
    except ImportError as error:  # of the file system, as fsspec says it
        raise _not_installed(text, error.__cause__ or error) from error
    except ValueError as error:  # of fsspec for a scheme that it does not know
        raise BagError(f"{text}: {error}") from error


def scheme_of(location: str | Path) -> str:
    """Return the scheme of a URL in lower case; empty for what is none.

    Parameters
    ----------
    location : str or Path
        Path or URL. A `Path` of a URL has made one slash of two.
    """
    found = re.match(r"([A-Za-z][A-Za-z0-9+.-]+):/(/?)", str(location))
    if found is None or (isinstance(location, str) and not found[2]):
        return ""
    return found[1].lower()


def _check_no_secret(scheme: str, rest: str) -> None:
    """Refuse a URL with a password or a signature, without repeating it."""
    # a password may hold a slash, and a path an @: of digits it is a port
    host, web = rest.partition("/")[0], scheme in ("http", "https")
    _, colon, port = host.partition("@")[0].partition(":")
    secret = colon and "@" in rest and ("@" in host or not port.isdigit())
    if secret or (web and "@" in host):  # before it, a token of a web server
        raise BagError(
            f"{scheme}://…: no password in a URL, which results would show: set it in the "
            "environment or in the configuration of fsspec"
        )
    address, _, query = rest.partition("?")
    if query and (web or "=" in query):  # in names of others is a "?" too
        raise BagError(
            f"{scheme}://{address}?…: no query in a URL, which results would show: use the store's "
            "own URL (s3://…) and a key from the environment, or download the bag"
        )


def find_bags(text: str) -> list[Path]:
    """Return the bags that a text names.

    Parameters
    ----------
    text : str
        Path, URL, or pattern with ``*``, ``?``, ``[…]`` or ``**``. What a pattern matches besides
        bags is passed over; a file within a bag stands for the bag.

    Returns
    -------
    bags : list of Path
        One, whether it is there or not, of a path or URL; all in the order of their names of a
        pattern.

    Raises
    ------
    BagError
        If a pattern matches no bag, or is one of a URL.
    """
    remote = scheme_of(text)
    if not glob.has_magic(text) or (not remote and Path(text).exists()):
        return [bag_path(text)]
    if remote:
        _check_no_secret(remote, text.partition("://")[2])
        raise BagError(f"{text}: patterns are those of files of this computer: name the bags")
    matched = [bag_at(Path(name)) for name in _matched(text)]
    found = [bag for bag in dict.fromkeys(matched) if bag is not None]
    if not found:
        raise BagError(f"{text}: matches no bag")
    return found


def _matched(pattern: str) -> list[str]:
    # `Path.glob` takes no pattern that begins at the root
    return sorted(glob.glob(pattern, recursive=True))  # noqa: PTH207


def bag_at(path: Path) -> Path | None:
    """Return the bag at a path of this computer: the folder or file itself, or a file's folder.

    Parameters
    ----------
    path : Path
        Path of a folder or file; for others the result is None.
    """
    if path.is_dir():
        parts = f"{glob.escape(path.name)}_*.mcap"  # of a recorder that was killed
        whole = (path / "metadata.yaml").is_file() or any(path.glob(parts))
        return path if whole else None
    if path.suffix in (".mcap", ".db3"):
        return bag_at(path.parent) or path
    return None


def is_remote(path: Path) -> bool:
    """Return whether a bag is behind a URL.

    Parameters
    ----------
    path : Path
        Location from `bag_path`.
    """
    return not isinstance(path, Path)


def check_apart(output: Path, bag: Path) -> None:
    """Refuse to write a new bag into the folder of one that is read.

    Parameters
    ----------
    output : Path
        Folder to create.
    bag : Path
        Location from `bag_path` of a bag to read.

    Raises
    ------
    BagError
        If the folder would be within the bag.
    """
    if is_remote(bag):
        return
    whole = bag_at(bag) or bag  # of one of its files
    if whole.resolve() in output.resolve().parents:
        raise BagError(f"{output}: is within the bag {whole}; name a folder beside it")


def _not_installed(text: str, error: BaseException) -> BagError:
    name = (getattr(error, "name", None) or "").partition(".")[0]
    return BagError(missing(name, f"{text}:") if name in EXTRAS else f"{text}: {error}")


def _options(scheme: str) -> dict[str, Any]:
    """Options of the file system, so that a server that falls silent is given up."""
    if scheme in ("http", "https"):
        from aiohttp import ClientTimeout

        waits = ClientTimeout(total=10.0 * TIMEOUT, sock_connect=TIMEOUT, sock_read=TIMEOUT)
        return {"client_kwargs": {"timeout": waits}}
    if scheme in ("s3", "s3a"):
        return {"config_kwargs": {"connect_timeout": TIMEOUT, "read_timeout": TIMEOUT}}
    if scheme in ("sftp", "ssh"):
        import_module("trajectory_recorder.bag.sftp")  # registers how they are read
        return {"silence": TIMEOUT}
    return {}
