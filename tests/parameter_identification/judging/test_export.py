"""Judged drives in files and figures."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from driven_bags import Scene, sideways
from matplotlib.figure import Figure

from parameter_identification.judging.export import ExportFormat, export, exported_files, plot
from parameter_identification.judging.judgement import judge


@pytest.mark.slow
def test_tum_export_agrees_with_evo(tmp_path: Path) -> None:
    evo_io = pytest.importorskip("evo.tools.file_interface")
    from evo.core.metrics import APE, PoseRelation

    j = judge(Scene(deviation=sideways(0.2), noise=0.01).write(tmp_path / "bag"))
    measured, reference = export([j], tmp_path / "out", ExportFormat.TUM)
    ape = APE(PoseRelation.translation_part)
    ape.process_data(
        (evo_io.read_tum_trajectory_file(reference), evo_io.read_tum_trajectory_file(measured))
    )
    statistics = ape.get_all_statistics()
    assert statistics["rmse"] == pytest.approx(j.rms, abs=1e-9)
    assert statistics["max"] == pytest.approx(j.max, abs=1e-9)


@pytest.mark.slow
def test_csv_and_figure(tmp_path: Path) -> None:
    j = judge(Scene(deviation=sideways(0.2)).write(tmp_path / "bag"))
    (path,) = export([j], tmp_path, ExportFormat.CSV)
    table = np.genfromtxt(path, delimiter=",", names=True)
    assert np.mean(table["along"] ** 2 + table["cross"] ** 2) == pytest.approx(j.te, rel=1e-12)
    again = export([j, j], tmp_path / "again", ExportFormat.CSV)
    assert [path.name for path in again] == ["bag.csv", "bag_2.csv"]
    dollars = replace(j, bag=tmp_path / "cost $x^{$")  # no formula
    plot([j, dollars], tmp_path / "figures" / "figure.png")
    assert (tmp_path / "figures" / "figure.png").read_bytes().startswith(b"\x89PNG")


def test_no_curve_of_a_figure_is_hidden(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    drawn = []

    def keep(figure: Figure, file: Path, **_: Any) -> None:
        file.write_bytes(b"")
        figure.canvas.draw()
        drawn.append(figure)

    monkeypatch.setattr(Figure, "savefig", keep)
    j = judge(Scene(noise=0.01).write(tmp_path / "bag"))
    for drives in ([j], [j, j]):
        plot(drives, tmp_path / "figure.png")
        figure = drawn[-1]
        for axes in figure.axes:
            legend = axes.get_legend().get_window_extent()
            assert not any(legend.overlaps(other.get_window_extent()) for other in figure.axes)
            assert figure.bbox.x0 <= legend.x0 < legend.x1 <= figure.bbox.x1
            assert figure.bbox.y0 <= legend.y0
        for axes in figure.axes[1::2]:
            names = [line.get_label() for line in axes.lines]  # in the order of drawing
            assert names == ["distance", "along the reference", "across, to the left"]


def test_no_drive_is_written_over_another_one() -> None:
    out = Path("out")
    same = [Path("a"), Path("a_2"), Path("other/a"), Path("more/a")]
    files = exported_files(same, out, ExportFormat.CSV)
    assert files == [(out / f"{name}.csv",) for name in ("a", "a_2", "a_3", "a_4")]
    alike = exported_files([Path("a"), Path("a_reference")], out, ExportFormat.TUM)
    assert len({file for files in alike for file in files}) == 4
