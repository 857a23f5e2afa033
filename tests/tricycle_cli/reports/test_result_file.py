"""`result.json` is read as it was written; what is missing in a file is None."""

import json

import pytest

from tricycle_cli.reports.result_file import DemoResult, DriveResult, ParameterResult
from tricycle_core.errors import ReportError


def test_it_is_read_as_it_was_written(tmp_path):
    result = DemoResult(
        {"designed": DriveResult({"radius": 2.0}, 0.4, 0.8, 1.2, 0.015, 0.016, 0.0155, 0.1)},
        {"yaw_inertia": ParameterResult(53.0, 52.0, 54.0, 54.1)},
    )
    values = result.to_json()
    assert list(values) == ["designed", "parameters"]
    assert values["designed"]["te_expected"] == 0.015
    assert values["parameters"]["yaw_inertia"] == {
        "estimate": 53.0, "low": 52.0, "high": 54.0, "truth": 54.1,
    }  # fmt: skip
    (tmp_path / "result.json").write_text(json.dumps(values))
    assert DemoResult.read(tmp_path / "result.json") == result


def test_a_file_may_hold_less_or_not_be_there(tmp_path):
    file = tmp_path / "result.json"
    assert DemoResult.read(file) == DemoResult()
    file.write_text(json.dumps({"designed": {"te_expected": 0.001, "other": "x"}}))
    assert DemoResult.read(file).drives["designed"] == DriveResult(te_expected=0.001)


@pytest.mark.parametrize("text", ["{", "[1]", '{"designed": {"rms": "x"}}', '{"designed": 1}'])
def test_another_file_is_refused_with_its_name(text, tmp_path):
    file = tmp_path / "result.json"
    file.write_text(text)
    with pytest.raises(ReportError, match=str(file)):
        DemoResult.read(file)
