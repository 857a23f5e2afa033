"""Files of identifications: written, read, and refused."""

import json

import numpy as np
import pytest
from found_identification import FOUND

from parameter_identification.identification_file import (
    document_of,
    load_identification_file,
    save_identification_file,
)
from tricycle_core.errors import IdentificationError

ENTRY = {"estimate": 1.0, "low": 0.5, "high": 2.0, "range": [0.0, 3.0]}


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "found" / "identification.json"
    save_identification_file(document_of(FOUND), path)
    return path


def test_the_keys_are_those_that_other_tools_read(file):
    content = json.loads(file.read_text(encoding="utf-8"))
    first, second = content["parameters"].values()
    assert list(first) == [
        *("estimate", "low", "high", "unit", "standard_deviation", "linear", "range"),
        *("identifiable", "profile", "truth"),
    ]
    assert first["profile"] == {"values": [590.0, 600.0, 612.0], "rise": [4.0, 0.0, 4.5]}
    assert first["truth"] == 601.0
    assert "truth" not in second
    assert second["profile"] is None
    assert content["correlation"][0] == pytest.approx([1.0, 1.0 / 35.0])
    assert content["noise"] == {
        "yaw rate": {"white": 0.005, "drift": 0.001, "drift_time": 2.0, "unit": "rad/s"}
    }
    assert [test["p"] for test in content["whiteness"]] == [0.5, None]
    assert content["nuisances"]["first"]["gyro bias"] == {
        "estimate": 0.1, "standard_deviation": 0.01, "unit": "rad/s",
    }  # fmt: skip
    assert content["rivals"] == [{"cornering_stiffness": 700.0, "yaw_inertia": 55.0}]
    assert content["starts"] == {"begun": 4, "agreed": 3}


def test_what_is_written_is_read(file):
    document = load_identification_file(file)
    assert document.to_json() == document_of(FOUND).to_json()
    assert document.parameters["cornering_stiffness"].range == (500.0, 1500.0)
    np.testing.assert_array_equal(document.covariance, FOUND.covariance)


def test_a_file_of_an_older_version_is_read(tmp_path):
    file = tmp_path / "identification.json"
    file.write_text(json.dumps({"level": 0.9, "parameters": {"a": ENTRY}}), encoding="utf-8")
    document = load_identification_file(file)
    assert document.parameters["a"].estimate == 1.0
    assert document.parameters["a"].truth is None


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"level": None}, "level"),
        ({"level": 2.0}, "level must lie between 0 and 1"),
        ({"parameters": {"a": {"estimate": "many"}}}, "estimate: needs a number"),
        ({"parameters": {"a": ENTRY | {"range": [1]}}}, "length 2"),
        ({"parameters": {"a": ENTRY | {"high": 1e999}}}, "numbers must be finite"),
        (
            {"parameters": {"a": ENTRY | {"profile": {"values": [1, 2], "rise": [1]}}}},
            "two lists of one length",
        ),
    ],
)
def test_what_is_wrong_is_said_with_its_place(file, change, message):
    content = json.loads(file.read_text(encoding="utf-8"))
    file.write_text(json.dumps(content | change), encoding="utf-8")
    with pytest.raises(IdentificationError, match=message) as caught:
        load_identification_file(file)
    assert str(caught.value).startswith(str(file))


def test_what_is_no_json_is_refused(file):
    file.write_text("estimates", encoding="utf-8")
    with pytest.raises(IdentificationError, match="is not JSON"):
        load_identification_file(file)
