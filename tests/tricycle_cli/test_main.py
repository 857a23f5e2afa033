"""The command line: a user's mistake is one line on stderr and status 2, never a traceback."""

import os
import re
import shlex
import subprocess
import sys
from importlib import resources
from pathlib import Path

import pytest

from trajectory_recorder.bag.reader import BagReader
from tricycle_cli.main import COMMANDS, main, parser

README = (Path(__file__).parents[2] / "README.md").read_text(encoding="utf-8")
COMMANDS_OF_README = re.findall(r"^ +(?:\$ )?\.venv/bin/tricycle (.*)$", README, re.M)


@pytest.fixture(autouse=True)
def in_a_folder_of_its_own(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "not_a_plan.json").write_text("{}")
    text = (resources.files("tricycle_sim") / "tricycle.yaml").read_text()
    assert "[500.0, 1500.0]" in text
    upside_down = text.replace("[500.0, 1500.0]", "[1500.0, 500.0]")
    (tmp_path / "upside_down.yaml").write_text(upside_down)
    known = re.sub(r"(camber_stiffness: \{)nominal: (\S+), range: \[.*?\]", r"\1value: \2", text)
    assert known != text
    (tmp_path / "camber_known.yaml").write_text(known)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("plan --target mass", "unknown target 'mass'"),
        ("plan --target yaw-inertia --samples 3", "samples = 3"),  # as yaw_inertia
        ("plan --maneuver figure-eight", "there are: circle, double_lane_change"),
        ("plan --at radius=3", "circle takes radius, speed; got radius"),
        ("plan --at radius=3 speed=fast", "'speed=fast': needs name=number"),
        ("plan --at radius=2 speed=1", "circle: the steering saturates at"),
        ("plan --noise-std -1", "noise_std = -1 m must be from 0 to 10"),
        ("plan --noise-std -1e-3", "noise_std = -0.001 m must be from 0 to 10"),
        ("plan --noise-std -inf", "noise_std = -inf m must be from 0 to 10"),
        ("plan --samples 3", "samples = 3"),
        ("plan --vehicle nowhere.yaml", "nowhere.yaml"),
        ("plan --vehicle cargo_tadpole", "tricycle_sim/cargo_tadpole.yaml meant?"),
        ("plan --vehicle car_1_10.yaml", "tricycle_sim/car_1_10.yaml meant?"),
        (
            "import a.csv --columns m.yaml --output not_a_plan.json/bag",
            "json is a file; a folder is",
        ),
        ("plan --vehicle .", "tricycle: .: is a folder; a file is needed"),
        ("plan --target camber_stiffness --vehicle camber_known.yaml", "'camber_stiffness'"),
        ("demo --target mass", "unknown target 'mass'"),
        ("demo --firmware nowhere", "nowhere/steer.elf does not exist"),
        ("plc probe /dev/nowhere", "/dev/nowhere"),
        ("plan --vehicle upside_down.yaml", "[1500, 500] is upside down"),
        ("plan show not_a_plan.json", "not_a_plan.json: schema None"),
        ("plan show nowhere.json", "tricycle: nowhere.json: No such file or directory"),
        ("plan sho plan.json", "needs `tricycle plan show FILE`"),
        ("drive nowhere.json", "nowhere.json"),
        ("drive nowhere.json --namespace one", "--namespace is of the vehicle's nodes: give"),
        ("judge nowhere", "nowhere"),
        (
            "simulate --maneuver circle radius=9 speed=0.8 --output a.csv",
            "outside its range 2 to 6; --range radius=LOW:HIGH sets another",
        ),
        ("vehicle check upside_down.yaml", "[1500, 500] is upside down"),
    ],
)
def test_a_mistake_is_one_line_and_status_2(line, message, capsys):
    assert main(line.split()) == 2
    output, errors = capsys.readouterr()
    assert output == ""
    last = [text for text in errors.splitlines() if text.startswith("tricycle: ")]
    assert len(last) == 1
    assert message in last[0]
    assert "Traceback" not in errors


@pytest.mark.parametrize(
    "error",
    [
        SystemError("returned a result with an exception set"),
        RuntimeError("Error calling __set_name__ on 'partialmethod' instance"),  # Python 3.11
    ],
)
def test_ctrl_c_in_compiled_code_is_an_interruption(monkeypatch, capsys, error):
    def interrupted(_arguments):
        raise error from KeyboardInterrupt()

    monkeypatch.setattr("tricycle_cli.commands.judge.run", interrupted)
    assert main(["judge", "bag"]) == 130
    assert capsys.readouterr().err == "tricycle: interrupted\n"


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_has_help_with_an_example(command, capsys):
    with pytest.raises(SystemExit) as stop:
        main([command, "--help"])
    assert stop.value.code == 0
    assert f"tricycle {command}" in capsys.readouterr().out.partition("example")[2]


@pytest.mark.parametrize("command", COMMANDS)
def test_help_fits_a_terminal_of_80_columns(command, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    with pytest.raises(SystemExit):
        main([command, "--help"])
    options = capsys.readouterr().out.split("\n\n", 1)[1]  # after the usage
    long = [line for line in options.splitlines() if len(line) > 80]
    assert [line for line in long if not line.startswith("  tricycle ")] == []


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("fly", "invalid choice: 'fly'"),
        ("idnetify bag", "invalid choice: 'idnetify'; did you mean identify?"),
        ("plan --targets mass", "tricycle plan: error: unrecognized arguments: --targets"),
        ("plan --targets mass", "did you mean --target? (see tricycle plan --help)"),
        ("drive p.json --overwrite", "arguments: --overwrite (see tricycle drive --help)"),
        ("demo --seed -4", "argument --seed: '-4': needs a whole number, 0 or more"),
        ("plan --budget 1.5", "argument --budget: '1.5': needs a whole number (see"),
        ("plan --noise-std -1cm", "argument --noise-std: '-1cm': needs a number (see"),
        ("judge bag --datum 91,11", "datum 91.0, 11.0: latitude is -90 to 90 degrees"),
        ("identify a.csv --window 0", "argument --window: '0': needs a number above 0 (see"),
        ("demo --real-time-factor fast", "'fast': must be from 0 (as fast as it runs) to 1000"),
        ("plc probe x --baud -5", "'-5' must be a whole number from 9600 to 1000000"),
        ("plc probe x --boot-wait nan", "'nan': needs a number, 0 or more"),
        ("plc monitor x --seconds 1e400", "'1e400': needs a number, 0 or more"),
        ("plc probe --json ", "needs the path of a serial device"),
        ("monitor --namespace /x/", "'/x/' is not a namespace, as in first or /yard/first"),
    ],
)
def test_an_argument_that_cannot_be_is_status_2(line, message, capsys):
    with pytest.raises(SystemExit) as stop:
        main(line.split(" "))
    assert stop.value.code == 2
    (said,) = capsys.readouterr().err.splitlines()
    assert message in said


@pytest.mark.ros
@pytest.mark.parametrize("domain", ["-1", "233", "\u00b2"])
def test_a_domain_that_there_is_not_is_refused(domain, monkeypatch, capsys):
    monkeypatch.setenv("ROS_DOMAIN_ID", domain)
    assert main(["monitor", "--json"]) == 2
    assert f"ROS_DOMAIN_ID = {domain}: must be a number" in capsys.readouterr().err


@pytest.mark.ros
def test_the_monitor_draws_nothing_into_a_pipe(capsys):
    assert main(["monitor"]) == 2
    assert "into a file or a pipe: --json" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize(
    ("library", "words", "extra"),
    [
        ("matplotlib", ["plan", "--output", "plan.json"], "plots"),
        ("jinja2", ["identify", "bag", "--output", "found"], "reports"),
        ("rclpy", ["demo"], "ros"),
        ("rclpy", ["monitor"], "ros"),
    ],
)
def test_a_library_that_is_missing_is_one_line_with_its_extra(tmp_path, library, words, extra):
    code = (
        f"import sys; sys.modules['{library}'] = None; from tricycle_cli.main import main\n"
        f"sys.exit(main({words}))"
    )
    before = set(tmp_path.iterdir())
    ended = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert ended.returncode == 2
    (line,) = ended.stderr.splitlines()
    assert line.endswith(f"needs {library}: pip install 'tricycle-excitation[{extra}]'")
    assert set(tmp_path.iterdir()) == before


def test_a_terminal_of_another_character_set_gets_what_it_can_show():
    code = "import sys; from tricycle_cli.main import main; sys.exit(main())"
    done = subprocess.run(
        [sys.executable, "-c", code, "campaign", "--help"],
        env=os.environ | {"PYTHONIOENCODING": "ascii"},
        capture_output=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert b"NAME[,NAME?]" in done.stdout


@pytest.mark.parametrize("how", [["--json"], []])
def test_files_are_written_though_nobody_reads_what_is_printed(record_drive, tmp_path, how):
    record_drive(tmp_path / "bag")
    reader, writer = os.pipe()
    os.close(reader)
    code = "import sys; from tricycle_cli.main import main; sys.exit(main())"
    judge = ["judge", "bag", "--export", "tum", "--output", "out", *how]
    with os.fdopen(writer) as closed:
        done = subprocess.run(
            [sys.executable, "-c", code, *judge],
            cwd=tmp_path,
            stdout=closed,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
        )
    assert done.returncode == 141
    assert "Error" not in done.stderr
    assert list((tmp_path / "out").iterdir())


@pytest.mark.parametrize("closed", [">&-", "2>&-", "<&- >&- 2>&-"])
def test_closed_standard_streams_lead_nowhere(record_drive, tmp_path, closed):
    record_drive(tmp_path / "bag")
    code = "import sys; from tricycle_cli.main import main; sys.exit(main())"
    words = [sys.executable, "-c", code, "bag", "convert", "bag", "--output", "copy"]
    line = f"{shlex.join(words)} {closed}"
    done = subprocess.run(line, shell=True, cwd=tmp_path, capture_output=True, check=False)
    assert done.returncode == 0, done.stderr
    assert b"Error" not in done.stderr
    with BagReader(tmp_path / "copy") as copy, BagReader(tmp_path / "bag") as bag:
        assert [*copy.messages_by_stamp()] == [*bag.messages_by_stamp()]


@pytest.mark.parametrize("buffered", [True, False])
@pytest.mark.parametrize(
    "line", ["--help", "plan --help", "--version", "judge no-bag", "judge --no-option"]
)
def test_a_closed_pipe_ends_a_command_quietly(line, buffered):
    reader, writer = os.pipe()
    os.close(reader)
    code = "import sys; from tricycle_cli.main import main; sys.exit(main())"
    environment = os.environ | {"PYTHONUNBUFFERED": "" if buffered else "1"}
    mistake = "judge" in line  # told on stderr
    with os.fdopen(writer) as closed:
        done = subprocess.run(
            [sys.executable, "-c", code, *line.split()],
            stdout=subprocess.PIPE if mistake else closed,
            stderr=closed if mistake else subprocess.PIPE,
            text=True,
            check=False,
            env=environment,
        )
    assert (done.returncode, done.stdout or done.stderr or "") == (141, "")


@pytest.mark.parametrize("line", COMMANDS_OF_README)
def test_the_readme_s_commands_need_no_more_arguments(line):
    arguments = shlex.split(line)
    assert callable(parser(arguments[:1]).parse_args(arguments).run)
