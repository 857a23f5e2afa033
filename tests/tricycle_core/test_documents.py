"""Documents: what is written is read back, and what does not fit is named with its place."""

import json
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
import pytest

from tricycle_core.documents import (
    check_texts,
    decode,
    encode,
    parse_json,
    read_bounded,
    write_whole,
)
from tricycle_core.errors import PlanError
from tricycle_core.quantities import FloatArray


class Colour(StrEnum):
    RED = "red"


@dataclass(frozen=True)
class Inner:
    values: FloatArray


@dataclass(frozen=True)
class Document:
    colour: Colour
    numbers: dict[str, float]
    inner: Inner | None = None

    def __post_init__(self):
        if self.inner is not None and self.inner.values.size == 0:
            raise PlanError("no values")


def test_a_document_survives_json():
    document = Document(Colour.RED, {"a": np.float64(0.5)}, Inner(np.array([[1.0, np.inf]])))
    text = json.dumps(encode(document)).encode()
    read = decode(Document, parse_json(text, "file", PlanError), "file", PlanError)
    assert (read.colour, read.numbers) == (Colour.RED, {"a": 0.5})
    assert np.array_equal(read.inner.values, [[1.0, np.inf]])


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"numbers": {}}, "file: lacks `colour`"),
        ({"colour": "blue", "numbers": {}}, "file: colour: Invalid enum value 'blue'"),
        ({"colour": "red", "numbers": {"a": True}}, r"file: numbers\[...\]: expected `float`"),
        ({"colour": "red", "numbers": {}, "inner": {}}, "file: inner: lacks `values`"),
        (
            {"colour": "red", "numbers": {}, "inner": {"values": [10**400]}},
            r"file: inner\.values: expected a list of numbers",
        ),
        ({"colour": "red", "numbers": {}, "inner": {"values": []}}, "file: no values"),
        ([], "file: expected `object`, got `array`"),
    ],
)
def test_what_does_not_fit_is_named_with_its_place(values, message):
    with pytest.raises(PlanError, match=message):
        decode(Document, values, "file", PlanError)


@pytest.mark.parametrize("text", [b"{", b"[NaN]", b"\xff", b"[" * 100_000, b"9" * 5000])
def test_what_is_no_json_is_refused(text):
    with pytest.raises(PlanError, match="file: is not JSON"):
        parse_json(text, "file", PlanError)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"a": [{"b": "\x1b[2J"}]}, r"file: a\.b must be a printable text"),
        ({"a": {"\n": 1}}, "file: a: its names must be printable"),
    ],
)
def test_texts_for_a_terminal_are_refused(values, message):
    with pytest.raises(PlanError, match=message):
        check_texts(values, "file", PlanError)
    check_texts({"a": ["Ä", 1.0, None]}, "file", PlanError)


def test_files_are_whole_and_bounded(tmp_path):
    file = tmp_path / "deep" / "file.json"
    write_whole(file, "äb")
    assert [path.name for path in file.parent.iterdir()] == ["file.json"]
    assert read_bounded(file, 3, "a plan", PlanError).decode() == "äb"
    with pytest.raises(PlanError, match="larger than 2 bytes; not a plan"):
        read_bounded(file, 2, "a plan", PlanError)
