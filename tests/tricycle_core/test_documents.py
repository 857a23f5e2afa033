"""Documents are complete or not there, and what does not fit is refused with its place."""

import errno
import json
import math
import threading
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tricycle_core.documents import (
    check_folder,
    check_texts,
    decode,
    encode,
    parse_json,
    parse_yaml,
    read_bounded,
    replacing,
    write_whole,
)
from tricycle_core.errors import ExcitationError, PlanError, message_of
from tricycle_core.quantities import FloatArray


class Kind(StrEnum):
    PATH = "path"
    COMMANDS = "commands"


@dataclass(frozen=True)
class Interval:
    low: float
    high: float


@dataclass(frozen=True, eq=False)
class Document:
    kind: Kind
    samples: FloatArray
    intervals: Mapping[str, Interval]
    ranges: Mapping[str, tuple[float, float]]
    comment: str | None = None


numbers = st.floats(allow_nan=False)
texts = st.text().filter(str.isprintable)


@pytest.mark.slow
@given(
    st.sampled_from(Kind),
    st.lists(st.tuples(numbers, numbers), min_size=1),
    st.dictionaries(texts, st.builds(Interval, numbers, numbers)),
    st.dictionaries(texts, st.tuples(numbers, numbers)),
    st.none() | texts,
)
def test_a_document_comes_back_as_it_was(kind, samples, intervals, ranges, comment):
    document = Document(kind, np.array(samples), intervals, ranges, comment)
    text = json.dumps(encode(document)).encode()
    back = decode(Document, parse_json(text, "file", PlanError), "file", PlanError)
    assert np.array_equal(back.samples, document.samples)
    assert (back.kind, back.intervals, back.ranges, back.comment) == (
        *(kind, intervals, ranges, comment),
    )


GOOD = {
    "kind": "path",
    "samples": [[0, 1.5]],
    "intervals": {"mass": {"low": 0, "high": 1.0}},
    "ranges": {"mass": [0.0, 1.0]},
}


@pytest.mark.parametrize(
    ("change", "place"),
    [
        ({"kind": "circle"}, "kind"),
        ({"kind": None}, "kind"),
        ({"samples": 3.0}, "samples"),
        ({"samples": [1.0, "x"]}, "samples"),
        ({"samples": [1.0, None]}, "samples"),
        ({"samples": [[1.0], [1.0, 2.0]]}, "samples"),
        (
            {"intervals": {"a": {"low": 0.0, "high": 1.0}, "b.c": {"low": True, "high": 1.0}}},
            r"intervals\.b\.c\.low",
        ),
        ({"intervals": {"a": {"low": 1.0, "high": 2.0}, "b": {"low": 0.0}}}, r"intervals\.b.*high"),
        ({"ranges": {"mass": [0.0, 1.0], "c": [1.0, "x"]}}, r"ranges\.c\[1\]"),
    ],
)
def test_what_does_not_fit_is_named(change, place):
    with pytest.raises(PlanError, match=rf"^plan\.json: .*{place}"):
        decode(Document, GOOD | change, "plan.json", PlanError)


def test_each_name_on_the_way_to_a_fault_is_told():
    values = {"front": [{}, {"left": 1.0}], "rear": [{"left": 1.0}, {"right": 2.0, "left": "x"}]}
    with pytest.raises(PlanError, match=r"^f: rear\[1\]\.left: needs a number, not a text"):
        decode(dict[str, list[dict[str, float]]], values, "f", PlanError)


def test_a_value_of_another_type_is_told_in_the_words_of_a_file():
    with pytest.raises(PlanError, match=r"^f: kind: needs a text, not a number; in quotes it is"):
        decode(Document, GOOD | {"kind": 2.5}, "f", PlanError)
    with pytest.raises(PlanError, match=r"^f: intervals: needs entries by name, not a list$"):
        decode(Document, GOOD | {"intervals": [1]}, "f", PlanError)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"a: \xf6", r"f: is not a text in UTF-8 \(byte 3\)"),
        (b"a: 1\n\tb: 2", r"f:2: is not valid YAML: found character '\\t' that cannot start"),
        (b"a: &b 1\nc: *b", "f: is not valid YAML: aliases are not read"),
        (b"a: \0", "f: is not valid YAML: special characters are not allowed"),
        (b"a: !!timestamp x", "f: is not valid YAML: 'NoneType' object"),
        (b"a: !!int ''", "f: is not valid YAML: string index out of range"),
        (b"a: !!bool x", "f: is not valid YAML: 'x'"),
        (b"!!map [1]", "f: is not valid YAML: cannot unpack"),
    ],
)
def test_what_is_not_yaml_is_told_with_the_reason(content, message):
    with pytest.raises(PlanError, match=message) as refusal:
        parse_yaml(content, "f", PlanError)
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize(("number", "taken"), [("010", "8"), ("1:30", "90"), ("-0_7", "-7")])
def test_a_number_that_yaml_takes_for_another_one_is_refused(number, taken):
    with pytest.raises(PlanError, match=f"^f:2: {number}: is {taken} in YAML"):
        parse_yaml(f"a: 1\nb: [{number}]".encode(), "f", PlanError)
    plain = b"{a: 0, b: 07.5, c: '010', d: 0.1, e: 10, f: 0x1f, g: 08}"
    assert parse_yaml(plain, "f", PlanError) == {
        "a": 0, "b": 7.5, "c": "010", "d": 0.1, "e": 10, "f": 31, "g": "08",
    }  # fmt: skip


def test_entries_of_a_newer_version_are_ignored():
    document = decode(Document, GOOD | {"newer": 1}, "plan.json", PlanError)
    assert document.intervals["mass"] == Interval(0.0, 1.0)


def test_a_field_that_an_older_file_lacks_is_written_again():
    document = decode(Document, GOOD, "plan.json", PlanError)
    assert encode(document) == GOOD | {"comment": None}


def test_infinity_is_a_number_and_nan_is_not():
    assert parse_json(b"[Infinity, -Infinity]", "f", PlanError) == [math.inf, -math.inf]
    with pytest.raises(PlanError, match="f: is not JSON"):
        parse_json(b"[NaN]", "f", PlanError)


def test_the_mark_that_windows_puts_before_utf_8_is_no_content():
    content = b'\xef\xbb\xbf{"a": 1}'
    assert parse_json(content, "f", PlanError) == parse_yaml(content, "f", PlanError) == {"a": 1}


@pytest.mark.parametrize("content", [b"", b"{", b"\xff", b"[" * 100_000, b"9" * 5000])
def test_what_is_not_json_is_one_line(content):
    with pytest.raises(PlanError) as refusal:
        parse_json(content, "f", PlanError)
    assert "\n" not in str(refusal.value)


def test_a_file_larger_than_expected_is_not_read(tmp_path):
    (tmp_path / "plan.json").write_bytes(b"12345")
    assert read_bounded(tmp_path / "plan.json", 5, "a plan", PlanError) == b"12345"
    with pytest.raises(PlanError, match=r"larger than 4 bytes; not a plan"):
        read_bounded(tmp_path / "plan.json", 4, "a plan", PlanError)


def test_a_failure_half_way_leaves_the_old_file_and_nothing_else(tmp_path):
    path = tmp_path / "new" / "table.csv"
    write_whole(path, "old")

    def fail_half_way():
        with replacing(path) as partial:
            assert partial.suffix == ".csv"
            partial.write_text("half")
            raise RuntimeError

    with pytest.raises(RuntimeError):
        fail_half_way()
    assert [p.name for p in path.parent.iterdir()] == ["table.csv"]
    assert path.read_text() == "old"
    write_whole(path, b"new")
    assert path.read_bytes() == b"new"


def test_threads_that_write_the_same_file_each_write_a_whole_one(tmp_path):
    path, both = tmp_path / "table.csv", threading.Barrier(2, timeout=10.0)

    def write(text):
        with replacing(path) as partial:
            both.wait()
            partial.write_text(text)
            both.wait()

    with ThreadPoolExecutor(2) as threads:
        list(threads.map(write, ("one", "two")))
    assert path.read_text() in ("one", "two")
    assert [p.name for p in tmp_path.iterdir()] == ["table.csv"]


def test_a_full_disk_is_told_with_the_file_that_was_wanted(tmp_path):
    path = tmp_path / "table.csv"

    def fill():
        with replacing(path):
            raise OSError(errno.ENOSPC, "No space left on device")

    with pytest.raises(OSError, match="No space left") as error:
        fill()
    assert message_of(error.value) == f"{path}: No space left on device"
    assert error.value.errno == errno.ENOSPC


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"a": [{"b": "\x1b[2J"}]}, r"file: a\.b must be a printable text"),
        ({"a": {"\n": 1}}, "file: a: its names must be printable"),
        ({"a": {1: 1}}, "file: a: its names must be .* texts; numbers need a decimal point"),
    ],
)
def test_texts_for_a_terminal_are_refused(values, message):
    with pytest.raises(PlanError, match=message):
        check_texts(values, "file", PlanError)
    check_texts({"a": ["Ä", 1.0, None]}, "file", PlanError)


def test_a_folder_is_checked_before_it_is_made(tmp_path):
    check_folder(tmp_path / "new" / "deep")
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "taken").touch()
    with pytest.raises(ExcitationError, match="taken is a file; a folder is needed"):
        check_folder(tmp_path / "taken" / "deep")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"time,x,y\n0,1,2\n", "f: is not JSON but another kind of file"),
        (b"", "f: is not JSON: it is empty"),
        (b'{"schema": 3,', "f: is not JSON: Expecting property name"),
    ],
)
def test_a_file_of_another_kind_is_told_as_one(content, message):
    with pytest.raises(PlanError, match=message):
        parse_json(content, "f", PlanError)
