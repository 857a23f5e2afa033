"""`tricycle demo`; what it writes is read in tests/tricycle_cli/reports/test_result_file.py."""

from tricycle_cli.main import main


def test_demo_does_not_touch_the_bags_of_an_earlier_one(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    bag = tmp_path / "demo" / "bags" / "designed"
    bag.mkdir(parents=True)
    assert main(["demo", "--output", "demo"]) == 2
    assert "holds bags already" in capsys.readouterr().err
    assert bag.exists()
