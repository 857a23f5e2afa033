"""Speed and accuracy of the vehicle beside its yardsticks, all in one run.

    python benchmarks/vehicle.py [--plot out/vehicle_cost.png] [--threads 2]

Needs g++; CommonRoad's and MuJoCo's lines need the extra `bench` and are left out without it.
Every time is the shortest of several, yardsticks taken in turn with ours.
"""

import argparse
import ctypes
import dataclasses
import math
import os
import re
import subprocess
import sys
import tempfile
import time
import tracemalloc
from collections.abc import Callable
from functools import partial
from importlib import import_module
from pathlib import Path

import matplotlib as mpl
import numpy as np
from numpy.typing import NDArray
from vehicle_checks import integration_errors

from excitation_planner.maneuver import DoubleLaneChange
from excitation_planner.planning.replay import nominal_run
from tricycle_bridge.commands.command_stream import VehicleCommand
from tricycle_core.timing import TICK
from tricycle_sim.commands import Commands
from tricycle_sim.rig.emulated import EmulatedRig
from tricycle_sim.rig.host import Host
from tricycle_sim.setpoints import command_rows, slew_all
from tricycle_sim.vehicle import Vehicle, load_vehicle
from tricycle_sim.vehicle.actuators import FRICTION_BRAKE, HUB_MOTOR
from tricycle_sim.vehicle.constants import constant_entries
from tricycle_sim.vehicle.groups import equilibrium, pack
from tricycle_sim.vehicle.kernel import functions_for
from tricycle_sim.vehicle.layout import LANES, SLOPE, STATE
from tricycle_sim.vehicle.parts import BLOCK, WHEEL, WHEEL_ROWS, steering_constants
from tricycle_sim.vehicle.planar import PlanarBlock, simulate_planar
from tricycle_sim.vehicle.tyre import LINEAR, TYRE

Array = NDArray[np.float64]
HERE = Path(__file__).parent
REPEATS = 9


def shortest(*runs: Callable[[], None], repeats: int = REPEATS) -> list[float]:
    """Shortest wall-clock time [s] of each, taken in turn."""
    best = [math.inf] * len(runs)
    for _ in range(repeats):
        for index, run in enumerate(runs):
            start = time.perf_counter()
            run()
            best[index] = min(best[index], time.perf_counter() - start)
    return best


def slalom(duration: float) -> Commands:
    """Sine steer at up to 2 m/s, commands at 50 Hz."""
    when = np.arange(0.0, duration + 0.01, 0.02)
    return Commands(when, 0.1 * np.sin(when), np.minimum(0.9 * when, 2.0))


def draw(vehicle: Vehicle, n: int) -> Array:
    """Return parameters (n, k), uniform in their ranges."""
    low, high = np.array(list(vehicle.unknown.values())).T
    return np.random.default_rng(0).uniform(low, high, (n, len(low)))


MAGIC = {
    "shape_longitudinal": 1.6,
    "curvature_longitudinal": 0.0,
    "shape_lateral": 1.3,
    "curvature_lateral": 0.0,
    "friction_load_slope": 0.0,
}
THROTTLE = {
    "throttle_full_setpoint": 4.0,
    **{f"throttle_torque_{percent}": 0.3 * percent for percent in (25, 50, 75, 100)},
}
LAWS: dict[str, tuple[dict[str, str], dict[str, float]]] = {
    "Fiala": ({"tyre": "fiala"}, {}),
    "Magic Formula": ({"tyre": "magic_formula"}, MAGIC),
    "servo with delay and play": (
        {"servo": "geared"},
        {"servo_delay": 0.034, "servo_backlash": 0.02},
    ),
    "direct torque": ({"motor": "direct_torque"}, {"setpoint_torque": 12.0}),
    "throttle curve": ({"motor": "throttle_curve"}, THROTTLE),
}
"""Parts and their constants that the paper's tricycle gets in place of its own."""


def with_parts(vehicle: Vehicle, parts: dict[str, str], own: dict[str, float]) -> Vehicle:
    """Return the vehicle with other laws."""
    values = {**vehicle.values, **own}
    entries = constant_entries(vehicle.wheels, parts)
    values = {name: value for name, value in values.items() if name in entries}
    return dataclasses.replace(vehicle, parts=parts, values=values)


def with_four_wheels(vehicle: Vehicle) -> Vehicle:
    """Return the vehicle with two wheels behind, in place of the one that it has there."""
    left, right, rear = vehicle.wheels
    pair = [dataclasses.replace(rear, name=f"rear_{side}") for side in ("left", "right")]
    wheels = (left, right, *pair)
    entries = constant_entries(wheels, {})
    values = {name: value for name, value in vehicle.values.items() if name in entries}
    values |= {f"rear_{w.name}.y": vehicle.of(w).y for w in (left, right)}
    return dataclasses.replace(vehicle, wheels=wheels, values=values)


def structures(vehicle: Vehicle, commands: Commands) -> None:
    """Print what a step of other wheels and laws costs, in multiples of the paper's tricycle."""
    others = {"four wheels": with_four_wheels(vehicle)}
    others |= {name: with_parts(vehicle, *laws) for name, laws in LAWS.items()}

    def replay(one: Vehicle) -> Callable[[], None]:
        parameters = draw(one, 128)
        return lambda: simulate_planar(one, commands, parameters, ignore, threads=1)

    first, *times = shortest(*(replay(one) for one in (vehicle, *others.values())), repeats=30)
    for name, seconds in zip(others, times, strict=True):
        line(f"  {name}: times three wheels, linear tyres", f"{seconds / first:.2f}")


def ignore(first: int, block: PlanarBlock) -> None:
    """Reduce a block to nothing."""


def line(what: str, figure: str) -> None:
    print(f"{what:<66} {figure}", flush=True)


HAND_WRITTEN_STATES = 24


def hand_written_layout(groups: Array) -> Array:
    """Return groups of the paper's tricycle with the rows in the order of `vehicle.cpp`."""
    right, rear = WHEEL_ROWS, 2 * WHEEL_ROWS
    spins = [STATE.spin, STATE.kappa, STATE.alpha]
    states = [*range(STATE.r + 1), *(row + 3 * wheel for row in spins for wheel in range(3))]
    x, y, z, inertia, inverse = (WHEEL.place + at for at in range(5))
    places = [x, x + rear, y, y + right, y + rear, z, inertia, inertia + rear]
    rows = [
        *states,
        *(STATE.torque, STATE.integrator),
        *3 * HAND_WRITTEN_STATES * [SLOPE],  # room for its own work
        *range(BLOCK.body, BLOCK.body + 9),
        *places,
        *(inverse, inverse + rear),
        *range(BLOCK.body + 9, BLOCK.motor),
        *range(WHEEL.tyre, WHEEL.tyre + len(TYRE)),
        *range(WHEEL.tyre_law, WHEEL.tyre_law + len(LINEAR)),
        *range(BLOCK.motor, BLOCK.motor + len(HUB_MOTOR)),
        *range(WHEEL.brake + rear, WHEEL.brake + rear + len(FRICTION_BRAKE)),
    ]
    return groups.reshape(len(groups), -1, LANES)[:, rows].reshape(len(groups), -1)


class HandWritten:
    """The C++ build: `vehicle.cpp`, called like the Python kernel, one core."""

    def __init__(self, vehicle: Vehicle, commands: Commands, n: int) -> None:
        library = Path(tempfile.mkdtemp()) / "vehicle.so"
        flags = ["-O3", "-march=native", "-ffast-math", "-shared", "-fPIC"]
        subprocess.run(["g++", *flags, "-o", library, HERE / "vehicle.cpp"], check=True)
        self._advance = ctypes.CDLL(str(library)).advance
        self.vehicle, self.parameters = vehicle, draw(vehicle, n)
        rows = command_rows(commands)
        ticks = len(rows)
        steering, _ = slew_all(commands.steering_motor_angle[rows], vehicle.steering_slew)
        speed, _ = slew_all(commands.speed[rows], vehicle.acceleration)
        self.drive = np.column_stack([np.ones(ticks), speed, np.zeros(ticks)])
        self.drive = np.vstack([self.drive, self.drive[-1:]])
        self.table = np.empty((2 * ticks + 1, 8))
        constants = steering_constants(vehicle, 0.5 * TICK)
        functions = functions_for(vehicle)
        functions.steer(np.zeros(2), steering, constants, 2, self.table, np.empty((2, ticks + 1)))
        self._python, self._start = functions.advance, equilibrium(vehicle)
        self.out = np.empty((4, n, ticks + 1))
        self.out_cpp = np.empty_like(self.out)
        self.steps = n * ticks
        self.rows = np.array([STATE.x, STATE.y, SLOPE + STATE.x, SLOPE + STATE.y])

    def pack(self) -> Array:
        """Return the vehicles at rest."""
        return pack(self.vehicle, self.parameters, self._start)

    def run_python(self) -> None:
        """Run the Python kernel."""
        lag = np.zeros(len(self.drive))
        self._python(self.pack(), self.table, lag, self.drive, 1, 0, self.rows, 1, self.out)

    def run_cpp(self) -> None:
        """Run the C++ one."""
        groups = hand_written_layout(self.pack())
        double, count = ctypes.c_double, ctypes.c_long
        address = [a.ctypes.data_as(ctypes.c_void_p) for a in (groups, self.table, self.drive)]
        self._advance(
            address[0],
            count(len(groups)),
            count(groups.shape[1]),
            count(4 * HAND_WRITTEN_STATES),
            *address[1:],
            count(len(self.drive) - 1),
            double(TICK),
            self.out_cpp.ctypes.data_as(ctypes.c_void_p),
        )


PEER_SECONDS = 4.0  # that CommonRoad's models simulate


def common_road(kind: str) -> Callable[[], None]:
    """A model of CommonRoad, `st` or `mb`, through odeint, commands held for 20 ms as ours."""
    from scipy.integrate import odeint
    from vehiclemodels.parameters_vehicle2 import parameters_vehicle2

    parameters = parameters_vehicle2()
    names = f"vehicle_dynamics_{kind}", f"init_{kind}"
    model, init = (getattr(import_module(f"vehiclemodels.{name}"), name) for name in names)
    core = [0.0, 0.0, 0.0, 2.0, 0.0, 0.0, 0.0]
    start = init(core, *([parameters] if kind == "mb" else []))

    def rate(state: Array, _: float, inputs: list[float]) -> list[float]:
        return model(state.tolist(), inputs, parameters)  # type: ignore[no-any-return]

    def run() -> None:
        state = np.array(start)
        for k in range(round(PEER_SECONDS / (2.0 * TICK))):
            inputs = [0.1 * math.cos(0.02 * k), 0.0]
            state = odeint(rate, state, [0.0, TICK, 2.0 * TICK], args=(inputs,))[-1]

    return run


def mujoco_vehicle(wheels: int, timestep: float, duration: float = 20.0) -> Callable[[], Array]:
    """MuJoCo's tricycle, or with two wheels behind, at a step; the run gives its last position."""
    import mujoco

    text = (HERE / "vehicle.xml").read_text()
    if wheels == 4:
        for part in re.findall(
            r'<body name="wheel_rear".*?</body>|<velocity.*?/>', text, re.DOTALL
        ):
            pair = [
                part.replace("rear", f"rear_{side}").replace("-0.0035", y)
                for side, y in (("left", "0.3065"), ("right", "-0.3135"))
            ]
            text = text.replace(part, "".join(pair))
    model = mujoco.MjModel.from_xml_string(text)
    model.opt.timestep = timestep
    steps = round(duration / timestep)

    def run() -> Array:
        data = mujoco.MjData(model)
        for k in range(steps):
            angle = 0.1 * math.sin(k * timestep)
            data.ctrl[:2] = angle
            data.ctrl[2:] = min(0.9 * k * timestep, 2.0) / 0.335
            mujoco.mj_step(model, data)
        return np.array(data.qpos[:2])

    return run


def peers(vehicle: Vehicle, commands: Commands, threads: int) -> None:
    """Print CommonRoad and MuJoCo beside ours, with three and with four wheels."""
    for wheels, own, kind, name in (
        (3, vehicle, "st", "single track"),
        (4, with_four_wheels(vehicle), "mb", "multi-body"),
    ):
        parameters = draw(own, 512)  # short runs, many of them: others use the machine too
        ours = partial(simulate_planar, own, commands, parameters, ignore, threads=threads)
        found = []
        for peer, seconds, prepare in (
            (f"CommonRoad {name}, odeint", PEER_SECONDS, partial(common_road, kind)),
            ("MuJoCo, steps of 5 ms", 20.0, partial(mujoco_vehicle, wheels, 0.005)),
        ):
            try:
                found.append((peer, seconds, prepare()))
            except ImportError:
                line(peer, "not installed")
        batch, *times = shortest(ours, *(run for _, _, run in found))
        pace = batch / (512 * 20.0)
        what = f"{wheels} wheels, {threads} threads, 512 samples"
        line(f"{what}: ns per vehicle step", f"{pace * TICK * 1e9:.0f}")
        line("  times real time", f"{1.0 / pace:.0f}")
        for (peer, seconds, _), taken in zip(found, times, strict=True):
            line(f"  {peer}: us per 10 ms", f"{taken / seconds * TICK * 1e6:.0f}")
            line("    times ours (all threads)", f"{taken / seconds / pace:.0f}")
            if peer.startswith("MuJoCo"):
                error = mujoco_vehicle(wheels, 0.005, 4.0)() - mujoco_vehicle(wheels, 0.0002, 4.0)()
                line(
                    "    planar error after 4 s against steps of 0.2 ms",
                    f"{np.hypot(*error):.1e} m",
                )


def lane_change(vehicle: Vehicle, threads: int) -> None:
    """200 samples of a double lane change of about 20 s, TE over 10 000 points."""
    run = nominal_run(vehicle, DoubleLaneChange(), np.array([4.0, 4.0]))
    parameters, errors = draw(vehicle, 200), np.empty(200)

    def reduce(first: int, block: PlanarBlock) -> None:
        errors[first : first + len(block.x)] = run.nominal.error(
            block.x, block.y, block.vx_world, block.vy_world
        )

    (seconds,) = shortest(
        lambda: simulate_planar(vehicle, run.commands, parameters, reduce, threads=threads)
    )
    line(
        f"200 samples of a {run.commands.duration:.1f} s double lane change with TE",
        f"{seconds:.3f} s",
    )


def live(vehicle: Vehicle) -> None:
    """Real-time factor of the live vehicle driven through both emulated PLCs, one core."""
    rig = EmulatedRig(vehicle)
    host = Host(rig)
    host.arm()

    def drive() -> None:
        for k in range(500):
            host.target = VehicleCommand(0.2 * math.sin(0.01 * k), 1.0)
            host.tick()

    (seconds,) = shortest(drive, repeats=5)
    assert rig.armed
    line("live vehicle, both PLCs and the bridge: times real time, one core", f"{5 / seconds:.0f}")


START = """
import time
from tricycle_sim.commands import Commands
from tricycle_sim.vehicle import load_vehicle
import tricycle_sim.vehicle.batch
begin = time.perf_counter()
tricycle_sim.vehicle.batch.simulate(load_vehicle(), Commands([0.0, 1.0], [0.0, 0.0], [1.0, 1.0]))
print(time.perf_counter() - begin)
"""


def start_up() -> None:
    """Seconds that the first and the second start pay before and for a simulation of a second."""
    with tempfile.TemporaryDirectory() as folder:
        environment = {**os.environ, "NUMBA_CACHE_DIR": folder}
        for which in ("first", "second"):
            run = subprocess.run(
                [sys.executable, "-c", START],
                env=environment,
                check=True,
                capture_output=True,
                text=True,
            )
            line(f"simulation of 1 s at the {which} start", f"{float(run.stdout):.2f} s")


def cost(vehicle: Vehicle, threads: int, plot: Path | None) -> None:
    """Time over samples and over steps, four decades each, and memory."""
    counts = LANES * np.logspace(0.0, 4.0, 13).astype(int)
    parameters = draw(vehicle, counts[-1])
    many = parameters[: 8 * LANES]  # so that steps, not calls, take the time

    def seconds(commands: Commands, samples: Array, threads: int) -> float:
        short = len(samples) * commands.duration < 20_000.0
        return shortest(
            lambda: simulate_planar(vehicle, commands, samples, ignore, threads=threads),
            repeats=30 if short else 3,
        )[0]

    def turn(ticks: int) -> Commands:
        return Commands([0.0, ticks * TICK], [0.1, 0.0], [1.0, 0.0])

    fixed = seconds(turn(1), parameters[:LANES], 1)
    line("fixed cost of a replay", f"{1e3 * fixed:.1f} ms")
    by_samples = [seconds(slalom(5.0), parameters[:n], threads) for n in counts]
    ticks = np.unique(np.logspace(1.0, 5.0, 13).astype(int))
    by_ticks = [seconds(turn(int(count)), many, 1) for count in ticks]

    def exponent(amount: Array, taken: list[float]) -> str:
        rest = np.array(taken) - fixed
        first = int(np.argmax(rest > fixed))  # before, the fixed cost hides the rest
        slope = np.polyfit(np.log(amount[first:]), np.log(rest[first:]), 1)[0]
        return f"{slope:.2f} ({amount[first]} to {amount[-1]})"

    line("exponent of the rest over samples of 500 steps", exponent(counts, by_samples))
    line(f"exponent of the rest over steps of {len(many)} samples", exponent(ticks, by_ticks))
    commands = slalom(20.0)
    for n in (100, 1000, 10_000):
        tracemalloc.start()
        simulate_planar(vehicle, commands, parameters[:n], ignore, threads=threads)
        _, peak = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        line(f"largest memory of {n} samples of 20 s", f"{peak / 2**20:.0f} MB")
    if plot is None:
        return
    mpl.use("Agg")
    from matplotlib import pyplot as plt

    def linear(amount: Array, seconds: list[float]) -> Array:
        return fixed + (seconds[-1] - fixed) / amount[-1] * amount

    figure, axes = plt.subplots(1, 2, figsize=(9, 4), sharey=True, layout="constrained")
    axes[0].loglog(counts, by_samples, "o-", label=f"measured, {threads} threads")
    axes[0].loglog(counts, linear(counts, by_samples), "k:", label="fixed cost and linear")
    axes[0].set(xlabel="samples of 5 s (500 steps)", ylabel="seconds")
    axes[1].loglog(ticks, by_ticks, "o-", label="measured, one thread")
    axes[1].loglog(ticks, linear(ticks, by_ticks), "k:", label="fixed cost and linear")
    axes[1].set(xlabel=f"steps of {len(many)} samples")
    for axis in axes:
        axis.legend()
        axis.grid(visible=True, alpha=0.3)
    plot.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(plot, dpi=120)
    line("plot", str(plot))


def main() -> int:
    """Print every figure."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--plot", type=Path, help="save the plot of the cost")
    parser.add_argument("--threads", type=int, default=2)
    args = parser.parse_args()
    vehicle = load_vehicle()
    commands = slalom(20.0)

    hand = HandWritten(vehicle, commands, 64)
    python, cpp = shortest(hand.run_python, hand.run_cpp, repeats=60)
    line("one core: ns per vehicle step", f"{python / hand.steps * 1e9:.0f}")
    line("C++, one core: ns per vehicle step", f"{cpp / hand.steps * 1e9:.0f}")
    line("  ours over C++", f"{python / cpp:.2f}")
    difference = float(np.abs(hand.out - hand.out_cpp)[:2].max())
    if not difference < 1e-6:
        raise SystemExit(
            f"vehicle.cpp drives other paths, {difference:.0e} m off: bring it up to date"
        )
    line("  largest difference of the paths", f"{difference:.0e} m")

    structures(vehicle, commands)

    peers(vehicle, commands, args.threads)
    error = integration_errors(vehicle)[1e3 * TICK]
    line("planar error of ours after 4 s against the oracle", f"{error:.1e} m")
    lane_change(vehicle, args.threads)
    live(vehicle)
    start_up()
    cost(vehicle, args.threads, args.plot)
    return 0


if __name__ == "__main__":
    sys.exit(main())
