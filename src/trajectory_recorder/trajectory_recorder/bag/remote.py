"""Files of bags behind URLs: ranges of bytes through `fsspec`, counted, checked, tried again.

Every answer has the length that was asked for, so that a connection that breaks never makes a short
bag; what is in it is checked by the sums of MCAP.
"""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from trajectory_recorder.bag.metadata import MAX_BYTES, NAME, parse_metadata
from tricycle_core.errors import BagError, message_of

NOT_FOUND = "not found"
TRIES = 4  # of each request
PAUSE = 0.5  # s before the second try; doubled before each further one
TAIL = 2**16  # bytes of a file's end that are fetched first: the summary of most bags
AHEAD = 2**12, 2**22  # least bytes of a request elsewhere: of the first; doubled each time, up to

_PASSING = (408, 425, 429)  # statuses of HTTP below 500 that another try may not meet

# what tells that a file has changed, as stores call it in lower case, with a "-" for a "_"
_STATE = (
    *("name", "size", "etag", "last-modified", "lastmodified", "mtime", "created"),
    *("content-md5", "md5hash", "md5-hash", "generation", "digest"),
)

T = TypeVar("T")


class RemoteFile:
    """A file behind a URL.

    Parameters
    ----------
    path : Path
        Location of the file, from `bag_path`.

    Attributes
    ----------
    size : int
        Size of the file [bytes].
    fetched : int
        Number of bytes of it that were received.

    Raises
    ------
    BagError
        From any method, if the file cannot be fetched.
    """

    def __init__(self, path: Any) -> None:
        self._path = path
        self.fetched = 0
        self._ahead, self._most = AHEAD
        self._held = (0, b"")
        self._file: Any = None
        self._state = _state_of(path)
        size = patiently(path, lambda: getattr(self._opened(), "size", None))
        if not isinstance(size, int):
            self.close()
            raise BagError(f"{path}: the server sends no parts of files: copy the bag here")
        self.size = size
        start = max(size - TAIL, 0)
        self._tail = (start, self._fetch(start, size))

    def read(self, start: int, size: int) -> bytes:
        """Return bytes of the file, fewer at its end.

        Parameters
        ----------
        start : int
            Position of the first byte.
        size : int
            Number of bytes.
        """
        end = min(start + size, self.size)
        if start >= end:
            return b""
        for first, data in (self._tail, self._held):
            if first <= start and end <= first + len(data):
                return data[start - first : end - first]
        self.expect(start, max(end, start + self._ahead))
        self._ahead = min(2 * self._ahead, self._most)
        return self._held[1][: end - start]

    def expect(self, start: int, end: int) -> None:
        """Fetch a range and hold it in place of the one before.

        Parameters
        ----------
        start, end : int
            First byte, and the one behind the last.
        """
        first, data = self._held
        if not (first <= start and end <= first + len(data)):
            self._held = (0, b"")  # not two of them at once
            self._held = (start, self._fetch(start, min(end, self.size)))

    def check_unchanged(self) -> None:
        """Compare what the server says of the file with what it said when the file was opened."""
        if _state_of(self._path) != self._state:
            raise BagError(f"{self._path}: changed while it was read; read it again")

    def close(self) -> None:
        """Give back connection and memory."""
        if self._file is not None:
            self._file.close()
        self._held = self._tail = (0, b"")

    def _opened(self) -> Any:
        """The open file; opened again after a failure, which may have cut the connection."""
        if self._file is None:
            self._file = self._path.fs.open(self._path.path, "rb", cache_type="none")
        return self._file

    def _fetch(self, start: int, end: int) -> bytes:
        def ask() -> bytes:
            file, self._file = self._opened(), None
            file.seek(start)
            data = bytes(file.read(end - start))
            self.fetched += len(data)
            if len(data) != end - start:
                raise OSError(f"the server sent {len(data)} bytes in place of {end - start}")
            self._file = file
            return data

        return patiently(self._path, ask)


def remote_files(path: Any) -> tuple[dict[str, Any], list[Path]]:
    """Return the content of metadata.yaml, and the MCAP files of a bag.

    Parameters
    ----------
    path : Path
        ``.mcap`` file or rosbag2 directory, from `bag_path`.

    Raises
    ------
    BagError
        If there is no bag, it cannot be fetched, or it is stored in another format.
    """
    if path.suffix == ".mcap":
        return {}, [path]
    text = patiently(path, lambda: _content(path / NAME))
    information = {} if text is None else parse_metadata(text, str(path / NAME))
    names = [str(name) for name in information.get("relative_file_paths") or []]
    if not names:  # the recorder was killed, or the folder has no such file
        names = patiently(path, lambda: _listed(path))
    files = [path / name for name in names if name.endswith(".mcap")]
    if not files or len(files) < sum(name.endswith((".mcap", ".db3", ".zstd")) for name in names):
        raise BagError(f"{path}: no .mcap files: only those are read from elsewhere")
    return information, files


def remote_state(path: Path) -> list[tuple[str, ...]]:
    """Return the server's state of each of a bag's files; it differs once a file has changed.

    Parameters
    ----------
    path : Path
        Location of the bag, from `bag_path`.

    Raises
    ------
    BagError
        As `remote_files`.
    """
    return [_state_of(file) for file in remote_files(path)[1]]


def _state_of(file: Any) -> tuple[str, ...]:
    def ask() -> tuple[str, ...]:
        file.fs.invalidate_cache()  # listings of a folder are kept
        told = {key.lower().replace("_", "-"): v for key, v in file.fs.info(file.path).items()}
        return tuple(f"{key}={told[key]}" for key in _STATE if key in told)

    return patiently(file, ask)


def _content(path: Any) -> bytes | None:
    """Content of metadata.yaml; None if there is none."""
    try:
        with path.fs.open(path.path, "rb") as file:
            return bytes(file.read(MAX_BYTES))
    except FileNotFoundError as error:
        if _reason(_first(error)) != NOT_FOUND:
            raise
        return None


def _listed(path: Any) -> list[str]:
    """Names in a folder."""
    entries = path.fs.ls(path.path, detail=False)
    return [str(entry).rstrip("/").rpartition("/")[2] for entry in entries]


def patiently(path: object, ask: Callable[[], T]) -> T:
    """Return a server's answer, after further tries where these may help.

    Parameters
    ----------
    path : object
        What is requested, for the message.
    ask : callable
        Sends the request and returns the answer.

    Raises
    ------
    BagError
        If it does not answer.
    """
    for attempt in range(TRIES):
        if attempt:
            time.sleep(PAUSE * 2 ** (attempt - 1))
        try:
            return ask()
        except Exception as raised:  # every file system has errors of its own
            error = _first(raised)
            if not _passing(error):
                raise BagError(f"{path}: {_reason(error)}") from error
            last = error
    raise BagError(f"{path}: {_reason(last)}; tried {TRIES} times") from last


def _first(error: BaseException) -> BaseException:
    """Return the root cause: fsspec reports a server that cannot be reached as a missing file."""
    while isinstance(error, FileNotFoundError) and error.__cause__ is not None:
        error = error.__cause__
    return error


def _passing(error: BaseException) -> bool:
    """Whether another try may do better."""
    if isinstance(status := getattr(error, "status", None), int):
        return status >= 500 or status in _PASSING
    return not isinstance(
        error, FileNotFoundError | PermissionError | ValueError | TypeError | ImportError
    )


def _reason(error: BaseException) -> str:
    """Why a request failed, in one line."""
    if isinstance(error, FileNotFoundError) or getattr(error, "status", None) == 404:
        return NOT_FOUND
    if isinstance(error, PermissionError):
        return f"access denied ({message_of(error)})"
    if isinstance(error, TimeoutError):
        return "the server did not answer in time"
    return message_of(error) or type(error).__name__
