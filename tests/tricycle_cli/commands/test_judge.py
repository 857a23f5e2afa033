"""`tricycle judge`: trajectory errors of bags."""

import errno
import json

import pytest
from driven_bags import DATUM, Scene, sideways

from tricycle_core.errors import BagError, JudgeError, PlanError


@pytest.mark.parametrize(
    ("arguments", "error", "reason"),
    [
        (("judge", "nowhere"), BagError, "nowhere: no such bag"),
        (("judge", "{bag}"), JudgeError, "no topic maneuver/reference"),
        (("judge", "{bag}", "--reference", "x"), JudgeError, "no topic x"),
        (("judge", "{bag}", "--output", "folder"), PlanError, "--output: only with --export"),
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


def test_bags_beside_one_that_cannot_be_opened_are_judged(tricycle, tmp_path, monkeypatch, capsys):
    from parameter_identification.judging import judgement

    judge = judgement.judge

    def locked(bag, **options):
        if bag.name == "locked":
            raise PermissionError(errno.EACCES, "Permission denied", str(bag))
        return judge(bag, **options)

    monkeypatch.setattr(judgement, "judge", locked)
    bag = Scene(deviation=sideways(0.2)).write(tmp_path / "bag")
    assert tricycle("judge", tmp_path / "locked", bag, "--json") == 2
    printed = capsys.readouterr()
    assert [one["bag"] for one in json.loads(printed.out)["bags"]] == [str(bag)]
    assert f"tricycle: {tmp_path / 'locked'}: Permission denied" in printed.err


@pytest.mark.parametrize(
    ("sides", "told"),
    [((1.0, 1.0), ""), ((1.0, -1.0), "are the mirror image of"), ((3.28, 3.28), "are 3.3 times")],
)
def test_poses_in_a_frame_or_unit_of_another_kind_are_told(tricycle, tmp_path, capsys, sides, told):
    def edit(messages):
        for _, message in messages["/odom"]:
            position = message.pose.pose.position
            position.x, position.y = sides[0] * position.x, sides[1] * position.y

    bag = Scene(edit=edit).write(tmp_path / "bag")
    assert tricycle("judge", bag) == 0
    expected = f"{bag}: the positions {told} the reference: they must be in m, " if told else ""
    assert capsys.readouterr().err[: len(expected) or None] == expected


def test_poses_without_heading_are_null_in_json(tricycle, tmp_path, capsys):
    bag = Scene(deviation=sideways(0.2), poses="fix").write(tmp_path / "bag")
    datum = f"{DATUM.latitude},{DATUM.longitude},{DATUM.altitude}"
    assert tricycle("judge", bag, "--datum", datum, "--anchor", "fit", "--json") == 0
    found = json.loads(capsys.readouterr().out, parse_constant=pytest.fail)
    assert found["te_by_anchor"]["start"] is None
    assert found["te_by_anchor"]["fit"] == found["te"]
