"""Files that the suite writes whole and reads as untrusted input.

A JSON document is a tree of frozen dataclasses. `encode` and `decode` (msgspec) turn it into plain
JSON values and back; whatever does not fit its type is refused with the place where it stands.
"""

from __future__ import annotations

import dataclasses
import functools
import json
import math
import operator
import os
import re
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

from tricycle_core.errors import ExcitationError

DocumentT = TypeVar("DocumentT")


def read_bounded(path: Path, limit: int, what: str, error: type[ExcitationError]) -> bytes:
    """Return the content of a file that is not larger than expected.

    Parameters
    ----------
    path : Path
        File to read.
    limit : int
        Largest size [bytes].
    what : str
        Expected content, for the message: "a plan".
    error : type
        Raised when the file is larger.

    Raises
    ------
    ExcitationError
        If the file is larger than `limit`; of the type `error`.
    OSError
        If the file cannot be read.
    """
    with Path(path).open("rb") as file:
        content = file.read(limit + 1)
    if len(content) > limit:
        raise error(f"{path}: larger than {limit} bytes; not {what}")
    return content


def nearest_existing(path: Path) -> Path:
    """Return a path if it exists, otherwise the lowest folder above it that does.

    Parameters
    ----------
    path : Path
        Path of a file or folder.

    Examples
    --------
    >>> nearest_existing(Path("/no-such-folder/bags/first")).as_posix()
    '/'
    """
    return next(there for there in (path, *path.parents) if there.exists())


def check_folder(path: Path) -> None:
    """Raise if nothing can be written to a folder; called before the work that fills it.

    Parameters
    ----------
    path : Path
        Folder; it need not exist, and is not made here.

    Raises
    ------
    ExcitationError
        If a file stands in the folder's place, or there is no permission to make it or to write
        into it.
    """
    existing = nearest_existing(path)
    if not existing.is_dir():
        raise ExcitationError(f"{existing} is a file; a folder is needed")
    if not os.access(existing, os.W_OK):
        raise ExcitationError(f"{existing}: no permission to write into this folder")


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Give a path to write to; the file replaces `path` once the block ends without an error.

    Missing folders are made. When the block raises, `path` is as it was and nothing is left behind.

    Parameters
    ----------
    path : Path
        File to be made or replaced.

    Yields
    ------
    partial : Path
        Temporary file in the same folder, with the same suffix.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    writer = f"{os.getpid()}-{threading.get_native_id()}"
    partial = path.with_name(f".{writer}.{path.name}")  # keeps the suffix
    try:
        yield partial
        partial.replace(path)
    except OSError as error:
        if error.errno is not None and error.filename in (None, str(partial)):
            raise OSError(error.errno, error.strerror, str(path)) from error  # e.g. a full disk
        raise
    finally:
        partial.unlink(missing_ok=True)


def write_whole(path: Path, content: str | bytes) -> None:
    """Write a file that is complete or not there; an old one is replaced at once.

    Parameters
    ----------
    path : Path
        File; missing folders are made.
    content : str or bytes
        A text is written in UTF-8.
    """
    with replacing(path) as partial:
        partial.write_bytes(content.encode() if isinstance(content, str) else content)


def parse_json(content: bytes, where: str, error: type[ExcitationError]) -> Any:
    """Return the values of a JSON text in UTF-8; infinite numbers are allowed, NaN is not.

    All its texts are printable, see `check_texts`.

    Parameters
    ----------
    content : bytes
        Content of the file.
    where : str
        Named first in the message, usually the file.
    error : type
        Raised when the content is not JSON.

    Raises
    ------
    ExcitationError
        If it is not JSON, or a text of it is not printable; of the type `error`.
    """
    try:
        values = json.loads(_text(content, where, error), parse_constant=_infinity)
    except error:  # a ValueError, too
        raise
    except (ValueError, RecursionError) as problem:
        why = f": {problem}"
        if isinstance(problem, json.JSONDecodeError) and problem.pos == 0:  # from its beginning on
            why = " but another kind of file" if content.strip() else ": it is empty"
        raise error(f"{where}: is not JSON{why}") from problem
    check_texts(values, where, error)
    return values


def parse_yaml(content: bytes, where: str, error: type[ExcitationError]) -> Any:
    """Return the values of a YAML text in UTF-8; no aliases: they can blow up a small file.

    Parameters
    ----------
    content : bytes
        Content of the file.
    where : str
        Named first in the message, usually the file.
    error : type
        Raised when the content is not YAML.

    Raises
    ------
    ExcitationError
        If it is not YAML, has aliases, a key twice in one mapping, or a number that YAML 1.1 reads
        as octal or to the base 60 (010 is 8, 1:30 is 90); of the type `error`, with the line.
    """
    import yaml  # slow to import, and plans need none

    class Loader(yaml.SafeLoader):
        def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
            if self.check_event(yaml.AliasEvent):
                raise yaml.YAMLError("aliases are not read")
            return super().compose_node(parent, index)

        def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
            seen = set()
            for key, _ in node.value:
                if (key.tag, str(key.value)) in seen:
                    line = key.start_mark.line + 1
                    raise error(f"{where}:{line}: {key.value}: is there twice")
                seen.add((key.tag, str(key.value)))
            return super().construct_mapping(node, deep)

        def construct_object(self, node: yaml.Node, deep: bool = False) -> Any:
            value = super().construct_object(node, deep)
            number = isinstance(value, int | float) and isinstance(node, yaml.ScalarNode)
            if number and re.fullmatch(r"[-+]?0[0-7_]+|.*:.*", text := str(node.value)):
                raise error(
                    f"{where}:{node.start_mark.line + 1}: {text}: is {value:g} in YAML: write "
                    "numbers without zeros before them and without colons; in quotes it is a text"
                )
            return value

    try:
        return yaml.load(_text(content, where, error), Loader=Loader)  # noqa: S506 - a safe loader
    except error:  # a ValueError, too
        raise
    except yaml.YAMLError as problem:
        mark = getattr(problem, "problem_mark", None)
        line = f":{mark.line + 1}" if mark else ""
        fault = getattr(problem, "problem", None) or getattr(problem, "reason", None) or problem
        raise error(f"{where}{line}: is not valid YAML: {fault}") from problem
    # numbers out of range, dates that do not exist, deep nesting, wrong tags
    except (
        *(ValueError, OverflowError, RecursionError),
        *(LookupError, AttributeError, TypeError),
    ) as problem:
        raise error(f"{where}: is not valid YAML: {problem}") from problem


def _text(content: bytes, where: str, error: type[ExcitationError]) -> str:
    try:
        return content.decode("utf-8-sig")  # Windows marks UTF-8
    except UnicodeDecodeError as problem:
        raise error(f"{where}: is not a text in UTF-8 (byte {problem.start})") from problem


def check_texts(values: object, where: str, error: type[ExcitationError]) -> None:
    """Refuse JSON values with texts that are not printable: terminal escapes, half characters.

    Parameters
    ----------
    values : object
        Values from a file; names are checked, too.
    where : str
        Named first in the message.
    error : type
        Raised when a text is not printable.

    Raises
    ------
    ExcitationError
        If a text is not printable; of the type `error`, naming the place.
    """
    places = [("", values)]
    while places:
        place, value = places.pop()
        inner: list[tuple[str, object]] = []
        if isinstance(value, dict):
            for name in value:
                if not (isinstance(name, str) and name.isprintable()):
                    what = f"{place}: " if place else ""
                    # YAML reads {x: 0,10} as {x: 0, 10: null}
                    comma = "; numbers need a decimal point" if isinstance(name, int) else ""
                    raise error(f"{where}: {what}its names must be printable texts{comma}")
            inner = [(f"{place}.{name}" if place else name, item) for name, item in value.items()]
        elif isinstance(value, list):
            inner = [(place, item) for item in value if isinstance(item, str | list | dict)]
        elif isinstance(value, str) and not value.isprintable():
            raise error(f"{where}: {place} must be a printable text")
        places += inner


def separator_of(lines: Iterable[str]) -> str:
    """Return the column separator of a table: the comma, unless another one occurs more often.

    Parameters
    ----------
    lines : iterable of str
        Lines of the table, e.g. an open file; the first line that is not blank is the header.

    Examples
    --------
    >>> separator_of(["", "time;x;y, of the COM"])
    ';'
    """
    header = next((line for line in lines if line.strip()), "")
    return max(",;\t", key=header.count)


def finite_or_none(value: float) -> float | None:
    """Return a number as JSON can hold it: None instead of NaN and of infinite numbers.

    Parameters
    ----------
    value : float
        Number of a document; NaN means that it is not known.

    Examples
    --------
    >>> finite_or_none(math.nan) is None
    True
    """
    return value if math.isfinite(value) else None


def encode(document: object) -> Any:
    """Return a document as plain JSON values: dict, list, str, numbers, None.

    Parameters
    ----------
    document : dataclass
        Dataclass whose fields may hold dataclasses, mappings, sequences, enumerations and arrays.
    """
    # field by field: msgspec leaves out those that `decode` left at their defaults
    if dataclasses.is_dataclass(document):
        return {f.name: encode(getattr(document, f.name)) for f in dataclasses.fields(document)}
    if isinstance(document, Mapping):
        return {encode(name): encode(value) for name, value in document.items()}
    if isinstance(document, list | tuple):
        return [encode(value) for value in document]
    import msgspec  # slow to import; --help and errors do not need it

    return msgspec.to_builtins(document, enc_hook=_plain)


def decode(
    kind: type[DocumentT], values: object, where: str, error: type[ExcitationError]
) -> DocumentT:
    """Return the document of a type that JSON values describe.

    Parameters
    ----------
    kind : type
        A dataclass; fields that are `FloatArray` take (nested) lists of numbers.
    values : object
        Values from `parse_json`; entries that the type does not know are ignored.
    where : str
        Named first in the message.
    error : type
        Raised when the values do not fit.

    Raises
    ------
    ExcitationError
        If the values do not fit; of the type `error`, naming the first entry that does not fit and
        what would.
    """
    import msgspec

    faults = (msgspec.ValidationError, ExcitationError)

    def fault_of(values: object) -> str:
        try:
            msgspec.convert(values, kind, dec_hook=_special)
        except faults as problem:
            return str(problem)
        return ""

    try:
        return msgspec.convert(values, kind, dec_hook=_special)
    except faults as problem:
        message = _with_names(str(problem), values, fault_of)
        raise error(f"{where}: {_plain_words(message)}") from problem


def _with_names(message: str, values: Any, fault_of: Callable[[object], str]) -> str:
    """Return msgspec's message with the names of mappings' entries, which it leaves out.

    An entry is at fault if the message is the same without the others.
    """
    _, _, place = message.partition(" - at `$")
    named = message
    keys: list[Any] = []
    for name, index in re.findall(r"\.([^.[`]+)|\[(\d+|\.{3})\]", place):
        key = int(index) if index.isdecimal() else name
        if index == "...":
            entries = functools.reduce(operator.getitem, keys, values)
            alone = (k for k in entries if fault_of(_with_only(k, keys, values)) == message)
            if (key := next(alone, None)) is None:
                break
            named = named.replace("[...]", f".{key}", 1)
        keys.append(key)
    return named


def _with_only(entry: Any, keys: Sequence[Any], values: Any) -> Any:
    """Return nested mappings and lists in which one mapping, found by keys, has only one entry."""
    if not keys:
        return {entry: values[entry]}
    changed = list(values) if isinstance(values, list) else dict(values)
    changed[keys[0]] = _with_only(entry, keys[1:], values[keys[0]])
    return changed


def _plain_words(message: str) -> str:
    """Return msgspec's message in the words of a file, with the place first.

    Examples
    --------
    >>> _plain_words("Expected `float`, got `str` - at `$.sensor.x`")
    'sensor.x: needs a number, not a text'
    """
    text, _, place = message.partition(" - at `$")
    text = text.replace("Object missing required field", "lacks")
    if fault := re.fullmatch(r"Expected `([^`]*)`( of length \d+)?, got `?([^`]*)`?", text):
        wanted = [kind for kind in fault[1].split(" | ") if kind != "null"]
        found = fault[3]
        text = f"needs {' or '.join(map(_kind, wanted))}{fault[2] or ''}, not {_kind(found)}"
        if "str" in wanted and found in ("int", "float", "bool", "date", "datetime"):
            text += "; in quotes it is a text"
    place = place.rstrip("`").lstrip(".")
    return f"{place}: {text}" if place else text


_KINDS = {
    "str": "a text",
    "int": "a whole number",
    "float": "a number",
    "bool": "true or false",
    "array": "a list",
    "object": "entries by name",
    "date": "a date",
    "datetime": "a date",
    "null": "nothing",
}
"""Kinds of values as a user knows them, by msgspec's names."""


def _kind(name: str) -> str:
    return _KINDS.get(name, name)


def _infinity(text: str) -> float:
    if text == "NaN":
        raise ValueError("NaN is not a number of a document")
    return float(text)


def _plain(value: object) -> object:
    if hasattr(value, "tolist"):  # an array or a number of NumPy
        return value.tolist()
    raise NotImplementedError(f"{type(value).__name__} has no JSON form")


_NO_NUMBERS = (bool, str, type(None))


def _special(kind: type, value: object) -> object:
    import numpy as np  # slow to import; nodes without arrays do not need it

    if getattr(kind, "__origin__", kind) is np.ndarray:
        try:
            array = np.array(value, dtype=float)
        except (TypeError, ValueError, OverflowError):
            array = None
        if (
            isinstance(value, list)
            and array is not None
            # NumPy would convert true, "2" and null to 1, 2 and NaN
            and not any(isinstance(v, _NO_NUMBERS) for v in np.array(value, dtype=object).flat)
        ):
            return array
        raise ValueError("needs a list of numbers")
    raise NotImplementedError(f"{kind} has no JSON form")
