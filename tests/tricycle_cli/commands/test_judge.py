"""`tricycle judge`: trajectory errors of bags."""

import pytest

from tricycle_core.errors import BagError, JudgeError


@pytest.mark.parametrize(
    ("arguments", "error", "reason"),
    [
        (("judge", "nowhere"), BagError, "nowhere: no such bag"),
        (("judge", "{bag}"), JudgeError, "no topic maneuver/reference"),
        (("judge", "{bag}", "--reference", "x"), JudgeError, "no topic x"),
    ],
)
def test_mistakes(tricycle, bag, arguments, error, reason):
    with pytest.raises(error, match=reason):
        tricycle(*(argument.format(bag=bag) for argument in arguments))


@pytest.mark.parametrize(
    "arguments",
    [
        ("judge", "bag", "--datum", "46"),
        ("judge", "bag", "--datum", "146,6"),
        ("judge", "bag", "--anchor", "elsewhere"),
        ("judge", "bag", "--export", "xml"),
        ("judge", "bag", "--plot", "figure.xls"),
        ("judge",),
    ],
)
def test_mistyped_options_are_argparses(tricycle, arguments, capsys):
    with pytest.raises(SystemExit) as status:
        tricycle(*arguments)
    assert status.value.code == 2
    assert capsys.readouterr().err
