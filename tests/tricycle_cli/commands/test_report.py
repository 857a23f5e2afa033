"""`tricycle report`: one file of whatever a folder holds."""

import json

import pytest

from tricycle_cli.main import main


@pytest.mark.slow
def test_the_command_writes_one_file_and_says_where(folder, capsys):
    assert main(["report", str(folder), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said == {"report": str(folder / "report.html"), "maneuvers": ["designed"]}
    assert {p.name for p in folder.iterdir()} == {"plans", "bags", "result.json", "report.html"}


def test_the_page_is_there_also_where_a_figure_cannot_be_written(tmp_path, monkeypatch):
    def fail(*_):
        raise OSError

    (tmp_path / "identification.json").write_text('{"level": 0.95, "parameters": {}}')
    monkeypatch.setattr("tricycle_cli.reports.figure_files.write_figures", fail)
    assert main(["report", str(tmp_path), "--figures", str(tmp_path / "figures")]) == 2
    assert (tmp_path / "run.html").exists()


@pytest.mark.slow
@pytest.mark.parametrize("where", ["", "bags", "bags/recorded", "plans/.."])
def test_any_directory_of_a_run_will_do(folder, where, capsys):
    assert main(["report", str(folder / where), "--output", str(folder / "r.html")]) == 0
    assert (folder / "r.html").stat().st_size > 1e6


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({}, "holds no plan"),
        ({"result.json": "[1]"}, "holds no plan"),
        ({"plan.json": "{"}, "not JSON"),
        ({"plan.json": "[" * 100_000}, "not JSON"),
        ({"plan.json": "{}"}, "plan.json: schema None"),
    ],
)
def test_a_mistake_is_one_line_and_nothing_is_written(content, message, tmp_path, capsys):
    for name, text in content.items():
        (tmp_path / name).write_text(text)
    assert main(["report", str(tmp_path)]) == 2
    errors = capsys.readouterr().err
    assert message in errors.splitlines()[-1]
    assert {p.name for p in tmp_path.iterdir()} == set(content)


@pytest.mark.slow
def test_the_report_of_identify_is_left_alone(identified, tmp_path):
    (tmp_path / "identification.json").write_text(json.dumps(identified))
    (tmp_path / "report.html").write_text("of identify")
    assert main(["report", str(tmp_path)]) == 0
    assert (tmp_path / "report.html").read_text() == "of identify"
    assert (tmp_path / "run.html").exists()
