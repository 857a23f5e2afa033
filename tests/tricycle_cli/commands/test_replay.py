"""`tricycle replay`: mistakes are found before anything is started."""

import pytest

from tricycle_core.errors import BagError


@pytest.mark.parametrize(
    ("arguments", "error", "reason"),
    [
        (("replay", "nowhere"), BagError, "no such bag"),
    ],
)
def test_mistakes(tricycle, bag, arguments, error, reason):
    with pytest.raises(error, match=reason):
        tricycle(*(argument.format(bag=bag) for argument in arguments))


@pytest.mark.parametrize(
    "arguments",
    [
        ("replay", "bag", "--rate", "nan"),
        ("replay", "bag", "--remap", "odom=x"),
    ],
)
def test_mistyped_options_are_argparses(tricycle, arguments, capsys):
    with pytest.raises(SystemExit) as status:
        tricycle(*arguments)
    assert status.value.code == 2
    assert capsys.readouterr().err
