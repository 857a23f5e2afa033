"""Nodes as child processes: their environment, their logs, their end."""

import json
import math
import os
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib.resources import files
from pathlib import Path

from tricycle_core.closing import Closing
from tricycle_core.errors import NodeError
from tricycle_core.start import ending_signals, ending_with_parent

OF_VEHICLE = "tricycle_bridge", "tricycle_sim", "maneuver_driver", "trajectory_recorder"
"""Nodes of which a domain has one each."""

DOMAINS = 100  # that are used
LAST_PORT = 65535
LAST_DOMAIN = 232  # the ports of the next one are beyond that
STOP_TIMEOUT = 5.0  # s a node gets to close its bag or port before it is killed
STOP_PERIOD = 0.1  # s between signals to a node in the foreground that is to end


def asked_domain() -> int | None:
    """Return the ROS domain that `ROS_DOMAIN_ID` names; None where it is not set, or is empty.

    Raises
    ------
    NodeError
        If there is no such domain.
    """
    text = os.environ.get("ROS_DOMAIN_ID", "")
    if not text:
        return None
    if not text.isdecimal() or int(text) > LAST_DOMAIN:
        raise NodeError(f"ROS_DOMAIN_ID = {text}: must be a number from 0 to {LAST_DOMAIN}")
    return int(text)


def own_domain(number: int = 0, pid: int | None = None) -> int:
    """Return a ROS domain for a process.

    From 1 to 100: above 101 a domain's ports are those that Linux hands out to any program.

    Parameters
    ----------
    number : int
        Several domains of one process have several numbers.
    pid : int, optional
        The process; this one by default.
    """
    return 1 + ((os.getpid() if pid is None else pid) * 13 + number) % DOMAINS


def free_domain() -> int:
    """Return a ROS domain in which nobody on this machine communicates: the first of `own_domain`.

    Two processes may have the same one, and each would take the other's nodes for its own. If all
    hundred are in use it is the first.
    """
    domains = map(own_domain, range(DOMAINS))
    return next((domain for domain in domains if not participants(domain)), own_domain())


def participants(domain: int) -> int:
    """Return how many processes on this machine communicate in a ROS domain.

    Parameters
    ----------
    domain : int
        ROS domain id.
    """
    found, first = 0, 7410 + 250 * domain
    # where each of them listens (DDSI-RTPS, section 9.6.1)
    for number in range(first, min(first + 240, LAST_PORT + 1), 2):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as port:
            try:
                port.bind(("", number))
            except OSError:
                found += 1
    return found


def ros_environment(*, domain: int, log_dir: Path) -> dict[str, str]:
    """Return the environment of node processes that communicate on this machine only.

    Parameters
    ----------
    domain : int
        ROS domain id; nodes of other domains are neither seen nor disturbed.
    log_dir : Path
        Folder into which ROS writes its logs.

    Returns
    -------
    env : dict of str to str
        This process's environment with the domain, local discovery and a Fast DDS profile
        that finds new processes within milliseconds.
    """
    profile = str(files("tricycle_bringup") / "fast_discovery.xml")
    return {
        **os.environ,
        "ROS_DOMAIN_ID": str(domain),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        _profile_variable(): profile,
        "ROS_LOG_DIR": str(log_dir),
        "PYTHONUNBUFFERED": "1",
    }


def _profile_variable() -> str:
    """Name of the variable with the profile's path: Fast DDS 3, of Kilted, warns of the old one."""
    prefixes = [*os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep), sys.prefix]
    new = any(list(Path(prefix, "lib").glob("libfastdds.so*")) for prefix in prefixes if prefix)
    return f"{'FASTDDS' if new else 'FASTRTPS'}_DEFAULT_PROFILES_FILE"


def executable(name: str) -> str:
    """Return the path of a node's executable: beside this Python first, then on PATH.

    Parameters
    ----------
    name : str
        Name of the executable.

    Raises
    ------
    NodeError
        If it is at neither place.
    """
    beside = Path(sys.executable).parent / name
    found = str(beside) if beside.exists() else shutil.which(name)
    if found is None:
        raise NodeError(f"{name}: not installed; run `make setup`, or source the workspace")
    return found


def run_in_foreground(
    name: str,
    parameters: Mapping[str, object],
    *,
    remappings: Sequence[str] = (),
    duration: float = math.inf,
    since: Path = Path(),
) -> int:
    """Run a node until it ends, or a signal that ends this process ends it.

    Parameters
    ----------
    name : str
        Name of the executable.
    parameters : mapping of str to object
        ROS parameters by name.
    remappings : sequence of str
        Remappings of topics, `/old:=/new`.
    duration : float
        Wall time [s] after which the node is ended, counted from when `since` exists.
    since : Path
        File or folder that the node makes; by default one that exists.

    Returns
    -------
    status : int
        Exit status of the node.
    """
    command = [*ending_with_parent(), executable(name), "--ros-args"]
    for key, value in parameters.items():
        command += ["-p", f"{key}:={json.dumps(value)}"]  # JSON is YAML
    for remapping in remappings:
        command += ["-r", remapping]
    stopped: list[int] = []
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # inherited: until it is up, Ctrl-C kills no node
    with subprocess.Popen(command) as process:  # noqa: S603 - our own executables
        for number in ending_signals():
            signal.signal(number, lambda number, _: stopped.append(number))
        end = math.inf
        while True:
            if end == math.inf and since.exists():
                end = time.monotonic() + duration
            try:
                return process.wait(STOP_PERIOD)
            except subprocess.TimeoutExpired:
                if stopped or time.monotonic() >= end:
                    process.send_signal(signal.SIGINT)  # again, until the node is up to take it


@contextmanager
def interrupts_held() -> Iterator[list[int]]:
    """Hold the signals that end a command back until the block has ended.

    Raised inside of rclpy, a KeyboardInterrupt may be lost.

    Yields
    ------
    came : list of int
        Signals that came; the block may clear it once it has heeded them.

    Raises
    ------
    KeyboardInterrupt
        At the end, if `came` is not empty.
    """
    came: list[int] = []
    if threading.current_thread() is not threading.main_thread():
        yield came  # Python raises interrupts in the main thread only
        return
    previous = {
        number: signal.signal(number, lambda number, _: came.append(number))
        for number in ending_signals()
    }
    try:
        yield came
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)
    if came:
        raise KeyboardInterrupt


class NodeProcesses(Closing):
    """Node processes that end together, in the reverse order of their start.

    Each runs in a session of its own, so that Ctrl-C reaches this process alone and the
    nodes are stopped in order; each writes to `log_dir/<name>.log`.

    Parameters
    ----------
    env : mapping of str to str
        Environment of the processes, see `ros_environment`.
    log_dir : Path
        Folder of the logs; it is made.
    """

    def __init__(self, env: Mapping[str, str], log_dir: Path) -> None:
        self._env = dict(env)
        self._log_dir = log_dir
        self._running: dict[str, subprocess.Popen[bytes]] = {}

    def start(self, name: str, *, config: str, parameters: Mapping[str, object]) -> None:
        """Start a node.

        Parameters
        ----------
        name : str
            Name of the node and of its executable.
        config : str
            Path of the parameter file.
        parameters : mapping of str to object
            Parameters that override those of the file.

        Raises
        ------
        NodeError
            If the executable is not installed.
        """
        command = [*ending_with_parent(), executable(name), "--ros-args", "--params-file", config]
        for key, value in parameters.items():
            # Named, it wins over the file's. JSON is YAML, which --ros-args reads; it quotes what
            # could be read as something else.
            command += ["-p", f"{name}:{key}:={json.dumps(value)}"]
        self._log_dir.mkdir(parents=True, exist_ok=True)
        with (self._log_dir / f"{name}.log").open("wb") as log:
            self._running[name] = subprocess.Popen(  # noqa: S603 - our own executables
                command, env=self._env, stdout=log, stderr=log, start_new_session=True
            )

    def check(self) -> None:
        """Raise if a node has ended.

        Raises
        ------
        NodeError
            Names the node, its exit status and the last line of its log, or the signal.
        """
        for name, process in self._running.items():
            if process.poll() is not None:
                log = self._log_dir / f"{name}.log"
                lines = log.read_text(errors="replace").strip().splitlines() or ["no output"]
                status = process.returncode
                if status < 0:  # its last line does not tell why
                    number = signal.Signals(-status).name
                    raise NodeError(f"{name} was ended by the signal {number} (see {log})")
                raise NodeError(f"{name} ended with status {status}: {lines[-1]} (see {log})")

    def close(self) -> None:
        """End the nodes; one that does not within `STOP_TIMEOUT` is killed."""
        with interrupts_held():  # a second Ctrl-C would leave them running
            for process in reversed(self._running.values()):
                if process.poll() is None:
                    process.send_signal(signal.SIGINT)
            deadline = time.monotonic() + STOP_TIMEOUT
            for process in self._running.values():
                try:
                    process.wait(max(0.0, deadline - time.monotonic()))
                except subprocess.TimeoutExpired:
                    process.kill()
                    process.wait()
