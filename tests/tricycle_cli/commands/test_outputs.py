"""Files that are there already are replaced only with --overwrite, whatever the subcommand."""

import pytest

from tricycle_core.errors import ExcitationError

COMMANDS = {
    "identify bag --output {}": "vehicle.yaml",
    "identify bag --drive-by-drive work --output {}": "identification.json",
    "fleet identify bag --output {}": "fleet.json",
    "judge bag --plot {}/judgement.png": "judgement.png",
    "judge bag --export csv --output {}": "bag.csv",
    "judge bag --export tum --output {}": "bag_reference.tum",
    "film bag --output {}/film.gif": "film.gif",
    "simulate --maneuver circle radius=3 speed=0.8 --output {}/c.csv --plot": "c.png",
    "reproduce table1 --output {}": "table1.svg",
    "vehicle check --draw {}/vehicle.svg": "vehicle.svg",
    "vehicle new {}/vehicle.yaml": "vehicle.yaml",
    "vehicle export-fmu --output {}/v.fmu": "v.fmu",
    "plan --output {}": "plan-2.json",
    "plc check a b --engineer A --record {}/r.json": "r.json",
    "demo --output {}": "identification/vehicle.yaml",
}


@pytest.mark.parametrize("command", COMMANDS)
def test_a_file_is_kept_and_named_before_any_work(tricycle, tmp_path, monkeypatch, command):
    monkeypatch.chdir(tmp_path)
    file = tmp_path / "out" / COMMANDS[command]
    file.parent.mkdir(parents=True)
    file.write_text("precious")
    with pytest.raises(ExcitationError) as caught:
        tricycle(*command.format(tmp_path / "out").split())
    assert str(caught.value) == f"{file}: exists already; --overwrite replaces it"
    assert file.read_text() == "precious"
    assert [path for path in (tmp_path / "out").rglob("*") if path.is_file()] == [file]


@pytest.mark.parametrize("command", [c for c, file in COMMANDS.items() if "{}/" in c])
def test_a_folder_in_the_place_of_a_file_is_refused(tricycle, tmp_path, monkeypatch, command):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "out" / COMMANDS[command]).mkdir(parents=True)
    with pytest.raises(ExcitationError, match="is a folder; the name of a file is needed"):
        tricycle(*command.format(tmp_path / "out").split(), "--overwrite")


@pytest.mark.slow
def test_a_report_and_its_figures_are_kept(tricycle, folder, tmp_path):
    report, figures = folder / "report.html", folder / "figures"
    assert tricycle("report", folder, "--figures", figures) == 0
    drawn = sorted(figures.iterdir())
    with pytest.raises(ExcitationError, match=r"report\.html: exists already"):
        tricycle("report", folder)
    report.unlink()
    for kept in drawn[1:]:
        kept.unlink()
    drawn[0].write_text("precious")
    with pytest.raises(ExcitationError, match=f"{drawn[0].name}: exists already"):
        tricycle("report", folder, "--figures", figures)
    assert not report.exists()
    assert [*figures.iterdir()] == drawn[:1]
    assert tricycle("report", folder, "--figures", figures, "--overwrite") == 0
    assert sorted(figures.iterdir()) == drawn
    assert drawn[0].read_text() != "precious"
