"""Start-up: CPU time of commands, and of nodes until they offer their services.

    python benchmarks/start_up.py [--bag BAG] [--repeat 5] [--no-nodes]

User and system time of the process and its children, the median of several starts, and as a
multiple of what importing NumPy takes. A node is up when another process finds its service
`get_parameters`; it is interrupted then, and its end counts too.
"""

import argparse
import os
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from tricycle_cli.operation.processes import executable, own_domain, ros_environment

PATIENCE = 60.0  # s for a node to come up
NODES = (
    *("tricycle_bridge", "tricycle_sim", "excitation_planner", "maneuver_driver"),
    *("trajectory_recorder", "bag_replayer", "identification_monitor"),
)


def waited(process: subprocess.Popen[bytes]) -> float:
    """User and system time of a process and its children, when it has ended."""
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    return usage.ru_utime + usage.ru_stime


def measure_commands(bag: Path | None, repeat: int) -> dict[str, float]:
    tricycle = executable("tricycle")
    commands = {
        "import numpy": [sys.executable, "-c", "import numpy"],
        "tricycle --help": [tricycle, "--help"],
        "tricycle plan --help": [tricycle, "plan", "--help"],
        "tricycle plan --bad": [tricycle, "plan", "--bad"],
    }
    if bag is not None:
        commands["tricycle judge BAG"] = [tricycle, "judge", str(bag)]
    found: dict[str, list[float]] = {name: [] for name in commands}
    for _ in range(repeat):  # in turns: a busy machine slows all of them alike
        for name, command in commands.items():
            silent = subprocess.DEVNULL
            found[name].append(waited(subprocess.Popen(command, stdout=silent, stderr=silent)))
    return {name: statistics.median(values) for name, values in found.items()}


def measure_nodes(bag: Path | None, repeat: int) -> dict[str, float]:
    import rclpy
    from rclpy.context import Context

    found = {}
    with tempfile.TemporaryDirectory() as folder:
        domain = own_domain()
        env = ros_environment(domain=domain, log_dir=Path(folder))
        os.environ.update(env)
        context = Context()
        rclpy.init(context=context, domain_id=domain)
        observer = rclpy.create_node("observer", context=context)

        def services() -> set[str]:
            return {name for name, _ in observer.get_service_names_and_types()}

        for name in NODES:
            arguments = ["--ros-args"]
            if name == "bag_replayer":
                if bag is None:
                    continue
                arguments += ["-p", f"bag:={bag}", "-p", "paused:=true"]
            if name == "tricycle_sim":
                arguments += ["-p", "steer_port:=steer", "-p", "drive_port:=drive"]
            service = f"/{name}/get_parameters"
            command = [executable(name), *arguments]
            found[name] = statistics.median(
                node_seconds(command, service, services, folder) for _ in range(repeat)
            )
        observer.destroy_node()
        rclpy.shutdown(context=context)
    return found


def node_seconds(
    command: list[str], service: str, services: Callable[[], set[str]], folder: str
) -> float:
    """CPU time of a node that is interrupted as soon as its service is found."""

    def wait(condition: Callable[[], bool]) -> None:
        deadline = time.monotonic() + PATIENCE
        while not condition():
            if time.monotonic() > deadline:
                raise SystemExit(f"{service}: waited {PATIENCE:.0f} s in vain")
            time.sleep(0.01)

    wait(lambda: service not in services())  # that of the start before
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, cwd=folder)
    wait(lambda: service in services() or process.poll() is not None)
    if process.poll() is not None:
        raise SystemExit(f"{command[0]} ended with status {process.returncode}")
    process.send_signal(signal.SIGINT)
    return waited(process)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("--bag", type=Path, help="recorded drive, to be judged and replayed")
    add("--repeat", type=int, default=5, help="starts of each (default: 5)")
    add("--no-nodes", action="store_true", help="commands only")
    args = parser.parse_args()
    bag = args.bag and args.bag.absolute()
    found = measure_commands(bag, args.repeat)
    if not args.no_nodes:
        found |= measure_nodes(bag, args.repeat)
    numpy = found["import numpy"]
    for name, seconds in found.items():
        print(f"{name:24} {seconds:6.2f} s {seconds / numpy:6.1f} x import numpy")


if __name__ == "__main__":
    main()
