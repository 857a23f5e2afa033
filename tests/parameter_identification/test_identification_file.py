"""Files of identifications: written, read, and refused."""

import json

import numpy as np
import pytest

from parameter_identification.drives.measured import Sensor
from parameter_identification.estimation.noise import NoiseLevel
from parameter_identification.estimation.results import (
    Combination,
    DriveFit,
    Estimate,
    HeldOut,
    Identification,
    NuisanceEstimate,
    Profile,
)
from parameter_identification.estimation.whiteness import Whiteness
from parameter_identification.identification_file import (
    document_of,
    load_identification_file,
    save_identification_file,
)
from tricycle_core.errors import IdentificationError

ENTRY = {"estimate": 1.0, "low": 0.5, "high": 2.0, "range": [0.0, 3.0]}
PROFILE = Profile(np.array([590.0, 600.0, 612.0]), np.array([4.0, 0.0, 4.5]))
FOUND = Identification(
    vehicle="tricycle",
    vehicle_hash="abc",
    parameters={
        "cornering_stiffness": Estimate(
            *("N/rad", 600.0, 5.0, 590.0, 611.0, (591.0, 610.0), (500.0, 1500.0), True, PROFILE)
        ),
        "yaw_inertia": Estimate("kg m^2", 50.0, 7.0, 40.0, 60.0, (40.0, 60.0), (25.0, 75.0), False),
    },
    covariance=np.array([[25.0, 1.0], [1.0, 49.0]]),
    fixed={"camber_stiffness": 50.0},
    hidden=(Combination({"yaw_inertia": 1.0}, 0.9),),
    noise={Sensor.YAW_RATE: NoiseLevel(0.005, 0.001, 2.0)},
    whiteness=(
        Whiteness("first", "x", 0.01, 0.1, 90.0, 100, 0.5),
        Whiteness("first", "wheel speed", 0.001, np.nan, np.nan, 100, np.nan),
    ),
    drives=(DriveFit("first", {"gyro bias": NuisanceEstimate(0.1, 0.01, "rad/s")}, {}, {}, {}),),
    held_out=(HeldOut("second", 0.2, 0.02, 0.014),),
    outliers=3,
    rivals=(np.array([700.0, 55.0]),),
    starts=(4, 3),
    truth={"cornering_stiffness": 601.0},
    level=0.95,
    seed=1,
    seconds=2.5,
)


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
        ({"level": None}, r"`\$\.level`"),
        ({"level": 2.0}, "level must lie between 0 and 1"),
        ({"parameters": {"a": {"estimate": "many"}}}, "`float`"),
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
