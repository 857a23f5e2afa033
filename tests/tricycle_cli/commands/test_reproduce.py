"""`tricycle reproduce` writes one report, and a picture of each item."""

import json

import pytest

from tricycle_cli.main import main


@pytest.mark.slow
def test_a_table_is_written_and_printed(tmp_path, capsys):
    assert main(["reproduce", "table1", "--output", str(tmp_path / "paper"), "--json"]) == 0
    table = json.loads(capsys.readouterr().out)["table1"]
    assert table["published"]["S of p1, exact"] == 0.0033
    assert table["ours"]["S of p1, exact"] == pytest.approx(0.0033, abs=5e-5)
    assert "8 reproduced" in table["verdict"]
    written = {path.name for path in (tmp_path / "paper").iterdir()}
    assert written == {"report.html", "table1.png", "table1.svg"}
    assert "Table 1" in (tmp_path / "paper" / "report.html").read_text()


def test_an_unknown_figure_is_status_2(capsys):
    with pytest.raises(SystemExit) as stop:
        main(["reproduce", "fig7"])
    assert stop.value.code == 2
    assert "fig8" in capsys.readouterr().err
