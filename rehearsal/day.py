"""A day on the proving ground, as a script: from a new vehicle to its parameters and a prediction.

    make rehearsal                               # or, with the firmware built:
    python rehearsal/day.py [--output out/rehearsal] [--plant mujoco]

Every step is a command that a user would type, or what a hand would do at the vehicle: arm it, pull
a cable, stand in the way of the localisation. The vehicle is a plant of other authors behind the
firmware on simulated boards. Its tyres are of a law that our model lacks, so that estimates end at
their ranges: the file is corrected as `tricycle identify` says. The day ends with status 0 if six
drives were driven, the two that a fault ended said so, the last drive was predicted better from the
others than by the first file, and no parameter that is shown is off by more than three standard
deviations. Whether the plant's are inside the 95 % intervals, of which one in twenty misses, and
the last drive inside its band, is printed.
"""

import argparse
import json
import math
import os
import pty
import re
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rcl_interfaces.srv import SetParameters
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from stand import Stand
from std_srvs.srv import SetBool

from tricycle_bridge.protocol.messages import Board
from tricycle_bringup.configuration import (
    SIMULATION_CONFIG,
    bridge_parameters,
    driver_parameters,
)
from tricycle_cli.operation.operator_node import ServiceCaller
from tricycle_cli.operation.processes import NodeProcesses, own_domain, ros_environment
from tricycle_core.nodes import LATCHED
from tricycle_sim.vehicle import load_vehicle

HERE = Path(__file__).parent
TRICYCLE = Path(sys.executable).with_name("tricycle")
PATIENCE = 900.0  # s: a loaded machine drives slower than it should
ANSWERS = (  # to the questions of `tricycle vehicle new`; empty: what is offered
    *("yard trike", "tadpole", "", "", "", "", "", "", ""),
    *("48", "1.44", "0.75", "50", "0.49", "0.335", "45", "2", "35", "48"),
)
FAMILIES = ("circle", "slalom", "step-steer")  # each drive and its mirror image
START = {"start_x": 12.0, "start_y": 8.0, "start_heading": 1.57}
SENSORS = ("--heading-std", "0.002", "--yaw-rate-std", "0.005", "--pose-rate", "50")
PACE = 2.0  # simulated s per s
FAR_OFF = 3.0  # standard deviations
IDENTIFICATIONS = 6  # at most: tyres of another law may be stiffer than any range
CONSTANTS = {  # that an effect changes by a share
    "relaxation length": "lateral_relaxation_length",
    "relaxation length along": "longitudinal_relaxation_length",
}
BRING_UPS = 3  # at most: the boards' times are measured by the wall clock
FAULT_AT = 4.0  # s after the start


def say(*words: object) -> None:
    print("\n$", *words, flush=True)


def command(*words: object, env: dict[str, str] | None = None, check: bool = True) -> str:
    """Run `tricycle` with these words; return what it printed, both ways."""
    say("tricycle", *words)
    done = subprocess.run(
        [TRICYCLE, *map(str, words)],
        env=env,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
    )
    last = [line for line in done.stdout.splitlines() if line.strip()]
    print(*(last if done.returncode else last[-12:]), sep="\n", flush=True)
    if check and done.returncode:
        sys.exit(f"the day ends here: tricycle {words[0]} failed")
    return done.stdout if done.returncode == 0 else f"failed: {done.stdout}"


def ask_for_vehicle(file: Path) -> None:
    """Answer the questions of `tricycle vehicle new` at a terminal."""
    say("tricycle vehicle new", file)
    pid, terminal = pty.fork()
    if pid == 0:
        os.execv(TRICYCLE, ["tricycle", "vehicle", "new", str(file)])
    os.write(terminal, "".join(f"{answer}\n" for answer in ANSWERS).encode())
    try:
        while text := os.read(terminal, 4096):
            sys.stdout.write(text.decode(errors="replace"))
    except OSError:  # the terminal is gone with its process
        pass
    if os.waitpid(pid, 0)[1]:
        sys.exit("the day ends here: the questions were not answered")


def check_boards(day: Path, vehicle: Path, firmware: Path) -> None:
    """Bring both boards up on a stand, again where the machine was too slow for real time."""
    if not any(brought_up(day, vehicle, firmware) for _ in range(BRING_UPS)):
        sys.exit("the day ends here: the boards did not pass their bring-up")


def brought_up(day: Path, vehicle: Path, firmware: Path) -> bool:
    """Run `tricycle plc check` with hands that do what it asks for; return whether all passed."""
    paths = {board: day / f"stand-{board.name.lower()}" for board in (Board.STEER, Board.DRIVE)}
    words = ["plc", "check", *paths.values(), "--engineer", "Rehearsal", "--vehicle", vehicle]
    words += ["--record", day / "bring_up.json", "--overwrite", "--boot-wait", "0"]
    say("tricycle", *words)
    with (
        Stand(load_vehicle(vehicle), firmware, paths) as stand,
        subprocess.Popen(
            [TRICYCLE, *map(str, words)],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        ) as check,
    ):
        for line in check.stdout or ():
            print(line, end="", flush=True)
            if ">>" in line:
                stand.do(line)
    return check.returncode == 0


class Hand:
    """What somebody does at the vehicle, and what they see of the drive."""

    def __init__(self, domain: int) -> None:
        self._context = Context()
        rclpy.init(context=self._context, domain_id=domain)
        self._node = rclpy.create_node("hand", context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._services = ServiceCaller(self._node, self.wait)
        self._state: dict[str, str] = {}
        self._failing: set[str] = set()  # items of the pre-flight
        self._looked = 0  # messages of it
        self._node.create_subscription(
            DiagnosticArray, "maneuver/preflight", self._on_preflight, LATCHED
        )
        self._node.create_subscription(DiagnosticStatus, "maneuver/state", self._on_state, LATCHED)

    def wait(self, condition: Callable[[], bool], what: str) -> None:
        deadline = time.monotonic() + PATIENCE
        while not condition():
            if time.monotonic() > deadline:
                raise TimeoutError(f"no {what} within {PATIENCE:g} s")
            self._executor.spin_once(timeout_sec=0.05)

    def arm(self) -> None:
        """Arm the boards, as soon as they can be."""

        def armed() -> bool:
            answer = self._services.call("tricycle_bridge/arm", SetBool, SetBool.Request(data=True))
            return bool(answer.success)

        self.wait(armed, "armed boards")

    def wait_for_preflight(self) -> None:
        """Look at the pre-flight until only the start pose is wrong: the vehicle drives there.

        Boards whose host was late after the drive disarm themselves, once it had found them armed:
        they are armed again.
        """
        seen = self._looked  # a message may have been waiting for long: the one after it is new

        def clean() -> bool:
            if self._looked < seen + 2:
                return False
            if "vehicle" in self._failing:
                self.arm()
            return not self._failing

        self.wait(clean, "clean pre-flight")

    def set(self, **parameters: Any) -> None:
        """Set parameters of the simulation."""
        values = [Parameter(name, value=value) for name, value in parameters.items()]
        request = SetParameters.Request(parameters=[v.to_parameter_msg() for v in values])
        answer = self._services.call("tricycle_sim/set_parameters", SetParameters, request)
        for result in answer.results:
            if not result.successful:
                raise RuntimeError(result.reason)

    def during_the_drive(self, driving: threading.Thread, **parameters: Any) -> None:
        """Set parameters of the simulation when a maneuver has run for a while."""

        def runs() -> bool:
            elapsed = float(self._state.get("elapsed") or 0.0)
            return self._state.get("state") == "running" and elapsed > FAULT_AT

        self.wait(lambda: runs() or not driving.is_alive(), "running maneuver")
        if not driving.is_alive():
            sys.exit("the day ends here: the drive ended before anything failed")
        self.set(**parameters)

    def _on_preflight(self, message: DiagnosticArray) -> None:
        failing = {item.name for item in message.status if item.level == DiagnosticStatus.ERROR}
        self._failing = {name for name in failing if not name.endswith("start")}
        self._looked += 1

    def _on_state(self, message: DiagnosticStatus) -> None:
        self._state = {pair.key: pair.value for pair in message.values}

    def close(self) -> None:
        self._executor.shutdown()
        rclpy.shutdown(context=self._context)


@contextmanager
def nodes_of_the_day(
    folder: Path, vehicle: Path, plant: str, firmware: Path
) -> Iterator[tuple[dict[str, str], Hand]]:
    """Start all nodes of the vehicle, armed; they end with the block."""
    domain = own_domain()
    env = ros_environment(domain=domain, log_dir=folder / "log" / "ros")
    ports = {f"{name}_port": str(folder / name) for name in ("steer", "drive")}
    with NodeProcesses(env, folder / "log") as nodes:
        nodes.start(
            "tricycle_sim",
            config=SIMULATION_CONFIG,
            parameters={
                **ports,
                **START,
                "vehicle_file": str(vehicle),
                "plant": plant,
                "plc": "firmware",
                "firmware": str(firmware.absolute()),
            },
        )
        hand = Hand(domain)
        try:
            hand.set(real_time_factor=PACE)
            nodes.start(
                "tricycle_bridge",
                config=SIMULATION_CONFIG,
                parameters={**ports, **bridge_parameters(str(vehicle)), "arm_on_activate": False},
            )
            nodes.start(
                "maneuver_driver",
                config=SIMULATION_CONFIG,
                parameters=driver_parameters(str(vehicle)),
            )
            nodes.start(
                "trajectory_recorder",
                config=SIMULATION_CONFIG,
                parameters={"metadata": [f"plant={plant}"]},
            )
            nodes.start(
                "identification_monitor",
                config=SIMULATION_CONFIG,
                parameters={"vehicle_file": str(vehicle)},
            )
            hand.arm()
            yield env, hand
        finally:
            hand.close()


def drive(plan: Path, bag: Path, vehicle: Path, env: dict[str, str], *, check: bool = True) -> str:
    words = ("drive", plan, "--vehicle-nodes", "--vehicle", vehicle, "--return", "--bag", bag)
    return command(*words, env=env, check=check)


def faulty(
    what: str, hand: Hand, drive: Callable[[], str], wrong: dict[str, Any], right: dict[str, Any]
) -> bool:
    """Let something fail during a drive; return whether the drive failed and said so."""
    print(f"\n({what})")
    outcome: list[str] = []
    driving = threading.Thread(target=lambda: outcome.append(drive()))
    driving.start()
    hand.during_the_drive(driving, **wrong)
    driving.join()
    hand.set(**right)
    hand.arm()
    hand.wait_for_preflight()
    return outcome[0].startswith("failed")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--output", type=Path, default=Path("out/rehearsal"))
    parser.add_argument("--plant", default="mujoco")
    parser.add_argument("--firmware", type=Path, default=Path("build/firmware"))
    arguments = parser.parse_args()
    day = arguments.output.absolute()
    if day.exists():
        sys.exit(f"{day}: is there already: remove it, or give another --output")
    (day / "bags").mkdir(parents=True)
    vehicle = day / "vehicle.yaml"
    ask_for_vehicle(vehicle)
    command("vehicle", "check", vehicle, "--draw", day / "vehicle.svg")
    check_boards(day, vehicle, arguments.firmware.absolute())
    plans = []
    for family in FAMILIES:
        folder = day / "plans" / family
        command(
            *("plan", "--vehicle", vehicle, "--area", HERE / "yard.yaml", "--maneuver", family),
            *(
                "--target",
                "front.cornering_stiffness",
                "--budget",
                "3000",
                *SENSORS,
                "--output",
                folder,
            ),
        )
        plans.append(folder / "plan.json")
    bags = [day / "bags" / f"{number}" for number in range(1, 7)]
    with nodes_of_the_day(day, vehicle, arguments.plant, arguments.firmware) as (env, hand):
        order = [plan for plan in plans for _ in range(2)]
        faults = {
            2: (
                "somebody trips over the cable of the drive board",
                {"faults": ["drive_cable"]},
                {"faults": [""]},
            ),
            4: (
                "the localisation jumps by 2 m",
                {"position_jump": 2.0},
                {"position_jump": 0.0},
            ),
        }
        stopped = []
        for number, (plan, bag) in enumerate(zip(order, bags, strict=True)):
            if number in faults:
                lost = bag.with_name(f"{bag.name}-aborted")
                what, wrong, right = faults[number]
                stopped.append(
                    faulty(
                        what,
                        hand,
                        lambda: drive(plan, lost, vehicle, env, check=False),  # noqa: B023
                        wrong,
                        right,
                    )
                )
            drive(plan, bag, vehicle, env)
    finish(day, vehicle, bags, stopped)


def finish(day: Path, vehicle: Path, bags: Sequence[Path], stopped: Sequence[bool]) -> None:
    """Identify, report and film the drives; say how the day went."""
    identify(day, vehicle, bags)
    command("report", day, "--vehicle", vehicle)
    for name, words in {
        "film.gif": (*bags[::2], "--speed", "4"),
        "rendered.gif": (bags[2], "--plant", "mujoco", "--speed", "2"),
    }.items():
        command("film", *words, "--vehicle", vehicle, "--output", day / name)
    judge(day, vehicle, stopped)


def identify(day: Path, vehicle: Path, bags: Sequence[Path]) -> None:
    """Identify, and again with a better file as long as an estimate is at an end of its range."""
    found, better = day / "identified", vehicle.with_name("better.yaml")
    better.write_text(vehicle.read_text())
    for _ in range(IDENTIFICATIONS):
        command(
            *("identify", *bags[:-1], "--held-out", bags[-1], "--vehicle", better),
            *("--other-vehicle", "--output", found, "--overwrite"),
        )
        if not correct(better, json.loads((found / "identification.json").read_text())):
            return


def correct(vehicle: Path, found: dict[str, Any]) -> bool:
    """Widen ranges and correct constants whose estimates are at an end; return whether any was."""
    before = vehicle.read_text()
    for name, parameter in found["parameters"].items():
        low, high = parameter["range"]
        if parameter["estimate"] in (low, high):
            limits = [low / 2, high] if parameter["estimate"] == low else [low, 2 * high]
            edit(vehicle, name, "range", r"\[.*?\]", lambda _, to=limits: str(to))
    for effect in found["effects"]:
        if effect["at_an_end"] and effect["name"] in CONSTANTS:
            name = CONSTANTS[effect["name"]]
            half_way = math.sqrt(1.0 + effect["estimate"])  # what else is wrong changes it too
            scale(vehicle, name, half_way)
            while command("vehicle", "check", vehicle, check=False).startswith("failed"):
                scale(vehicle, name, 1.1)  # stiffer than the steps of the simulation allow
    return vehicle.read_text() != before


def scale(vehicle: Path, name: str, factor: float) -> None:
    edit(vehicle, name, "value", r"[\d.e-]+", lambda value: f"{factor * float(value):.4g}")


def edit(vehicle: Path, name: str, key: str, pattern: str, new: Callable[[str], str]) -> None:
    """Change the value of a constant's key in a vehicle file as a hand does."""
    text = vehicle.read_text()
    entry = re.search(rf"(?m)^  {re.escape(name)}: .*?\b{key}: ({pattern})", text)
    if entry is None:
        sys.exit(f"the day ends here: no {key} of {name} in the vehicle file")
    value = new(entry[1])
    say(f"edit {vehicle}: the {key} of {name} becomes {value}, it was {entry[1]}")
    vehicle.write_text(text[: entry.start(1)] + value + text[entry.end(1) :])


def judge(day: Path, vehicle: Path, stopped: Sequence[bool]) -> None:
    """Print how the day went; end with status 1 if a fault was not told, or something is wrong."""
    document = json.loads((day / "identified" / "identification.json").read_text())
    held, of_plant = document["held_out"][0], load_vehicle(vehicle).nominal
    print(
        f"\n{len(stopped)} faults, {sum(stopped)} told by a drive that failed; the sixth drive, "
        f"not used, is predicted to {1e3 * held['rms_estimated']:.0f} mm (rms; expected "
        f"{1e3 * held['expected']:.0f} mm), inside its {document['level']:.0%} band for "
        f"{held['inside']:.0%} of the samples; by the first file to "
        f"{1e3 * held['rms_nominal']:.0f} mm; noise alone: {1e3 * held['noise']:.0f} mm"
    )
    right = []
    for name, found in document["parameters"].items():
        low, high = (found[end] for end in ("low", "high"))
        off = (found["estimate"] - of_plant[name]) / found["standard_deviation"]
        right.append(not found["identifiable"] or abs(off) <= FAR_OFF)
        outside = not low <= of_plant[name] <= high
        shown = f"{low:.4g} to {high:.4g} {found['unit']}"
        print(
            f"{name}: {shown if found['identifiable'] else 'not shown'}; in the plant "
            f"{of_plant[name]:.4g}{f', which is OUTSIDE ({off:+.1f} sigma)' if outside else ''}"
        )
    better = held["rms_estimated"] < held["rms_nominal"]
    sys.exit(int(not (all(stopped) and better and all(right))))


if __name__ == "__main__":
    main()
