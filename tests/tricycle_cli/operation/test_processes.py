"""Child processes and signals."""

import shutil
import signal
import socket
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from tricycle_cli.operation.processes import (
    LAST_DOMAIN,
    NodeProcesses,
    asked_domain,
    executable,
    free_domain,
    interrupts_held,
    own_domain,
    participants,
    ros_environment,
    run_in_foreground,
)
from tricycle_core.errors import NodeError


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupt_waits_for_what_is_under_way(number):
    before = signal.getsignal(number)
    steps = []

    def interrupted():
        with interrupts_held():
            signal.raise_signal(number)
            steps.append("done")

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert steps == ["done"]
    assert signal.getsignal(number) is before


def test_another_thread_is_never_interrupted():
    def step():
        with interrupts_held():
            return "done"

    with ThreadPoolExecutor() as pool:
        assert pool.submit(step).result() == "done"


def test_an_executable_that_is_not_installed_is_told():
    assert executable(Path(sys.executable).name) == sys.executable
    with pytest.raises(NodeError, match="no_such_node: not installed"):
        executable("no_such_node")


def test_nodes_get_a_domain_of_their_own(tmp_path):
    assert own_domain() != own_domain(1)
    env = ros_environment(domain=7, log_dir=tmp_path)
    assert env["ROS_DOMAIN_ID"] == "7"
    assert Path(env["FASTRTPS_DEFAULT_PROFILES_FILE"]).exists()


def test_a_domain_in_which_others_communicate_is_not_taken() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as participant:
        participant.bind(("", 7410 + 250 * own_domain()))
        assert free_domain() != own_domain()


def test_the_last_domain_has_fewer_ports_than_the_others():
    first = 7410 + 250 * LAST_DOMAIN
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as participant:
        participant.bind(("", first + 2))
        assert participants(LAST_DOMAIN) == 1


@pytest.mark.parametrize(("text", "domain"), [(None, None), ("", None), ("0", 0), ("232", 232)])
def test_an_empty_domain_is_none(text, domain, monkeypatch):
    if text is None:
        monkeypatch.delenv("ROS_DOMAIN_ID", raising=False)
    else:
        monkeypatch.setenv("ROS_DOMAIN_ID", text)
    assert asked_domain() == domain


@pytest.fixture
def node(tmp_path, monkeypatch):
    """Install an executable that prints its arguments and ends with status 3."""
    file = tmp_path / "some_node"
    file.write_text('#!/bin/sh\necho "$@"\nexit 3\n')
    file.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:/usr/bin:/bin")
    return file.name


def test_a_node_that_has_ended_is_told_with_its_last_words(node, tmp_path):
    with NodeProcesses({"PATH": "/usr/bin:/bin"}, tmp_path / "log") as nodes:
        nodes.start(node, config="nodes.yaml", parameters={"rate": 2.5, "name": "on"})
        while True:
            try:
                nodes.check()
            except NodeError as error:
                ended = str(error)
                break
    assert ended.startswith("some_node ended with status 3: --ros-args --params-file nodes.yaml")
    assert '-p some_node:rate:=2.5 -p some_node:name:="on"' in ended


def test_a_node_that_was_killed_is_told_with_the_signal(node, tmp_path):
    (tmp_path / node).write_text("#!/bin/sh\necho all is well\nkill -9 $$\n")
    log = tmp_path / "log"
    with NodeProcesses({"PATH": "/usr/bin:/bin"}, log) as nodes:
        nodes.start(node, config="nodes.yaml", parameters={})
        told = ""
        while not told:
            try:
                nodes.check()
            except NodeError as error:
                told = str(error)
    assert told == f"some_node was ended by the signal SIGKILL (see {log / 'some_node.log'})"


@pytest.fixture
def handlers_kept():
    """Leave the handlers of signals as they were."""
    ends = signal.SIGINT, signal.SIGTERM, signal.SIGHUP
    before = {number: signal.getsignal(number) for number in ends}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


def test_a_node_in_the_foreground_ends_with_its_own_status(node, handlers_kept, capfd):
    parameters = {"topics": ["odom"]}
    assert run_in_foreground(node, parameters, remappings=["/odom:=/other"]) == 3
    assert capfd.readouterr().out == '--ros-args -p topics:=["odom"] -r /odom:=/other\n'


def test_the_duration_of_a_node_in_the_foreground_counts_from_what_it_makes(
    node, tmp_path, handlers_kept, capfd
):
    (tmp_path / node).write_text(
        f"#!{sys.executable}\n"
        "import pathlib, signal, sys, time\n"
        "time.sleep(1.0)\n"  # slow to start
        f"pathlib.Path({str(tmp_path / 'bag')!r}).mkdir()\n"
        "begin = time.monotonic()\n"
        "signal.signal(signal.SIGINT, lambda *_: sys.exit(print(time.monotonic() - begin)))\n"
        "time.sleep(60)\n"
    )
    run_in_foreground(node, {}, duration=0.5, since=tmp_path / "bag")
    assert 0.5 <= float(capfd.readouterr().out) < 30.0


@pytest.mark.parametrize("end", [signal.SIGTERM, signal.SIGHUP, signal.SIGKILL])
def test_a_node_in_the_foreground_ends_with_its_command(node, tmp_path, end):
    if end == signal.SIGKILL and not shutil.which("setpriv"):
        pytest.skip("needs setpriv")
    (tmp_path / node).write_text(
        f"#!{sys.executable}\n"
        "import signal, time\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "print('runs', flush=True)\n"
        "time.sleep(60)\n"
    )
    run = f"from {NodeProcesses.__module__} import *; run_in_foreground({node!r}, {{}})"
    command = [sys.executable, "-c", run]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as process:
        assert process.stdout.readline() == b"runs\n"
        process.send_signal(end)
        assert process.stdout.read() == b""  # its end, when the node has ended too
        assert process.wait() == (-end if end == signal.SIGKILL else 0)
