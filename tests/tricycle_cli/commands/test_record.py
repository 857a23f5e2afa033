"""`tricycle record`: mistakes are found before anything is started."""

import pytest

from tricycle_cli.commands import record
from tricycle_core.errors import BagError


@pytest.mark.parametrize(
    ("arguments", "error", "reason"),
    [
        (("record", "--output", "{bag}"), BagError, "exists: a bag is not overwritten"),
    ],
)
def test_mistakes(tricycle, bag, arguments, error, reason):
    with pytest.raises(error, match=reason):
        tricycle(*(argument.format(bag=bag) for argument in arguments))


@pytest.mark.parametrize(
    "arguments",
    [
        ("record", "--duration", "-3"),
        ("record", "--split-size", "big"),
        ("record", "--metadata", "vehicle_id"),
    ],
)
def test_mistyped_options_are_argparses(tricycle, arguments, capsys):
    with pytest.raises(SystemExit) as status:
        tricycle(*arguments)
    assert status.value.code == 2
    assert capsys.readouterr().err


def test_entries_of_the_metadata_are_given_to_the_recorder(tricycle, tmp_path, monkeypatch):
    def parameters_of(name, parameters, **_):
        assert parameters["metadata"] == ["vehicle_id=trike_7", "site=yard=2"]
        return 3

    monkeypatch.setattr(record, "run_in_foreground", parameters_of)
    entries = "vehicle_id=trike_7", "site=yard=2"
    assert tricycle("record", "--output", str(tmp_path / "b"), "--metadata", *entries) == 3
