"""What the shell completes, and what help says of defaults."""

import shutil
import subprocess

import pytest

from tricycle_cli.main import COMMANDS, main


@pytest.fixture(scope="module")
def script():
    import contextlib
    import io

    with contextlib.redirect_stdout(io.StringIO()) as output, pytest.raises(SystemExit):
        main(["--completion", "bash"])
    return output.getvalue()


@pytest.mark.skipif(shutil.which("bash") is None, reason="needs bash")
@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("tricycle pl", {"plan", "plc"}),
        ("tricycle plan --cr", {"--criterion"}),
        ("tricycle vehicle ch", {"check"}),
        ("tricycle record --compression lz", {"lz4"}),
        ("tricycle ", set(COMMANDS)),
    ],
)
def test_bash_completes(script, line, expected):
    words = line.split(" ")
    run = f"""{script}
COMP_WORDS=({" ".join(f"'{word}'" for word in words)}); COMP_CWORD={len(words) - 1}
_tricycle; printf '%s\\n' "${{COMPREPLY[@]}}"
"""
    done = subprocess.run(["bash", "-c", run], capture_output=True, text=True, check=True)
    assert set(done.stdout.split()) == expected


@pytest.mark.parametrize(
    ("command", "texts"),
    [
        ("plan", ["(default: circle)", "(default: 100)", "(default: out/plan)", "(default: 0.02)"]),
        ("drive", ["(default: out/bag)", "(default: 1.0)"]),
        ("identify", ["of the starts (default: 0)"]),
        ("judge", ["(default: maneuver/reference)", "(default: standstill)"]),
        (
            "campaign",
            [
                "(default: 6000)",
                "(default: 0.002, with --vehicle-nodes 0)",
                "(default: circle,double_lane_change)",
            ],
        ),
    ],
)
def test_help_tells_defaults(command, texts, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    with pytest.raises(SystemExit):
        main([command, "--help"])
    said = " ".join(capsys.readouterr().out.split())
    for text in texts:
        assert text in said
