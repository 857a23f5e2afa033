"""Figures as image files."""

import dataclasses
from pathlib import Path

import pytest
from matplotlib.figure import Figure

from parameter_identification.judging.judgement import judge
from tricycle_cli.reports.static_figures import plot_drives, plot_plan

PNG, SVG = b"\x89PNG", b"<?xml"


@pytest.mark.slow
@pytest.mark.parametrize(("suffix", "begin"), [("png", PNG), ("svg", SVG)])
def test_a_plan_is_drawn_in_the_format_of_the_suffix(suffix, begin, plan, tmp_path):
    plot_plan(plan, tmp_path / f"plan.{suffix}")
    assert (tmp_path / f"plan.{suffix}").read_bytes().startswith(begin)


def test_a_figure_that_is_cut_off_leaves_the_old_one(plan, tmp_path, monkeypatch):
    def cut_off(figure, file, **_):
        Path(file).write_bytes(PNG)
        raise OSError

    monkeypatch.setattr(Figure, "savefig", cut_off)
    (tmp_path / "plan.png").write_text("old")
    with pytest.raises(OSError):  # noqa: PT011
        plot_plan(plan, tmp_path / "plan.png")
    assert [file.read_text() for file in tmp_path.iterdir()] == ["old"]


@pytest.mark.slow
def test_what_a_set_will_teach_is_drawn_too(plan, tmp_path):
    predicted = dict.fromkeys(plan.unknown, 0.01)
    plot_plan(plan, tmp_path / "alone.png")
    plot_plan(dataclasses.replace(plan, predicted_std=predicted, drives=2), tmp_path / "set.png")
    alone, of_set = ((tmp_path / f"{name}.png").read_bytes() for name in ("alone", "set"))
    assert alone != of_set


@pytest.mark.slow
def test_drives_are_drawn_beside_each_other(record_drive, tmp_path):
    record_drive(tmp_path / "bag")
    judgement = judge(tmp_path / "bag")
    plot_drives({"one": judgement, "two": judgement}, tmp_path / "drives.png")
    assert (tmp_path / "drives.png").read_bytes().startswith(PNG)
