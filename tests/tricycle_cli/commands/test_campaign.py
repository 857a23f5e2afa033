"""`tricycle campaign`: a mistake is found before anything is made."""

import pytest

from tricycle_cli.main import main


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("--targets mass --tolerance 5%", "unknown target 'mass'"),
        ("--targets camber_stiffness --tolerance five", "tolerance 'five': want a share"),
        ("--targets camber_stiffness --tolerance 500%", "tolerance 5 must be"),
        ("--targets camber_stiffness --tolerance 5% --maneuver loop", "unknown maneuver 'loop'"),
    ],
)
def test_a_mistake_is_one_line_and_leaves_nothing(line, message, capsys, tmp_path):
    output = tmp_path / "campaign"
    assert main(["campaign", *line.split(), "--output", str(output)]) == 2
    assert message in capsys.readouterr().err
    assert not output.exists()
