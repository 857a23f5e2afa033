"""Sessions: nodes, simulated or of the vehicle, on which plans are driven."""

import math
import os
import shutil
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Protocol

import numpy as np

from excitation_planner.plan import Plan
from excitation_planner.preflight import RECORDER
from tricycle_bringup.configuration import (
    IDENTIFYING,
    SIMULATION_CONFIG,
    bridge_parameters,
    check_bridge,
    driver_parameters,
)
from tricycle_cli.console import plain_console
from tricycle_cli.operation.dashboard import DiagnosticEntry, diagnostics_table
from tricycle_cli.operation.enough import Enough
from tricycle_cli.operation.processes import (
    OF_VEHICLE,
    NodeProcesses,
    asked_domain,
    free_domain,
    participants,
    ros_environment,
)
from tricycle_core.diagnostics import Level
from tricycle_core.errors import NodeError, PlanError
from tricycle_core.quantities import Progress
from tricycle_core.readiness import TOPIC
from tricycle_sim.plants import OWN
from tricycle_sim.vehicle import Vehicle, draw_truth, load_vehicle


class DrivePlan(Protocol):
    """Drives a plan, to its end or until it has taught enough, and records the bag."""

    def __call__(
        self, plan: Plan, bag: Path, progress: Progress, enough: Enough | None = None
    ) -> None:
        """Drive; the progress is in ms."""


IDLE_PACE = 1.0
"""Real-time factor between the drives: what plans and identifies meanwhile needs the processor."""

SILENCES = {"odom_timeout": 0.5, "state_timeout": 1.0}
"""Time without a message of each kind that ends a run [s of wall time].

The nodes count it on the simulated clock. On a busy machine the middleware takes 50 to 130 ms to
send a lost message again, which is more than a second of a simulation at ten times real time.
"""

FASTEST = 20.0
"""Real-time factor up to which these times are kept: the driver takes no longer ones."""


@contextmanager
def simulated_session(
    *,
    vehicle_file: Path | None,
    true_seed: int,
    real_time_factor: float,
    folder: Path,
    firmware: Path | None = None,
    plant: str = OWN,
    back: Path | None = None,
    monitor: bool = False,
    noise_seed: int = -1,
) -> Iterator[DrivePlan]:
    """Start simulation, bridge, driver and recorder; end them all when the block ends.

    Parameters
    ----------
    vehicle_file : Path, optional
        Vehicle YAML; None: the packaged tricycle.
    true_seed : int
        Seed of the hidden true parameters; negative: the nominal ones.
    real_time_factor : float
        Largest ratio of simulated to wall time during a drive; an armed simulation also waits for
        its host.
    folder : Path
        Folder for logs and the links to the ptys.
    firmware : Path, optional
        Build of the real firmware to run on simulated UNOs; None: emulated PLCs.
    plant : str
        Name of the plant that the boards drive.
    back : Path, optional
        Makes the vehicle drive to the start of each further drive, and at the end to that of the
        last one, instead of being put there: the folder for the bag of this last way.
    monitor : bool
        Whether `identification_monitor` runs too, so that a drive can end once it has determined
        enough.
    noise_seed : int
        Seed of the sensors' noise; negative: another one in every session, so that the drives of
        two sessions are independent.

    Yields
    ------
    drive : DrivePlan
        Resets the simulation, drives a plan, records its bag.

    Raises
    ------
    NodeError
        If a node cannot be started or ends by itself, or there is no domain ROS_DOMAIN_ID.
    """
    # imported here: without ROS the rest of the command line works
    from tricycle_cli.operation.operator_node import Operator, refuse_company

    asked = asked_domain()
    domain = free_domain() if asked is None else asked
    if others := participants(domain):
        refuse_company(domain, OF_VEHICLE, others)
    env = ros_environment(domain=domain, log_dir=(folder / "log" / "ros").absolute())
    os.environ.update(env)
    ports = {
        "steer_port": str((folder / "steer").absolute()),
        "drive_port": str((folder / "drive").absolute()),
    }
    vehicle = load_vehicle(vehicle_file)
    file = "" if vehicle_file is None else str(vehicle_file.absolute())
    hurry = min(max(real_time_factor or FASTEST, 1.0), FASTEST)
    with NodeProcesses(env, folder / "log") as nodes:
        config = SIMULATION_CONFIG
        nodes.start(
            "tricycle_sim",
            config=config,
            parameters={
                **ports,
                "vehicle_file": file,
                "true_seed": true_seed,
                "noise_seed": noise_seed,
                "plant": plant,
                "real_time_factor": IDLE_PACE,
                **({"plc": "firmware", "firmware": str(firmware.absolute())} if firmware else {}),
            },
        )
        nodes.start(
            "tricycle_bridge",
            config=config,
            parameters={**ports, **bridge_parameters(file), "arm_on_activate": False},
        )
        nodes.start(
            "maneuver_driver",
            config=config,
            parameters={
                **driver_parameters(file),
                **{name: hurry * silence for name, silence in SILENCES.items()},
            },
        )
        # the truth too, so that estimates from the bag can be compared with it
        metadata = [f"vehicle={vehicle.name}", f"vehicle_hash={vehicle.fingerprint}"]
        if plant == OWN:
            metadata += [f"true_{k}={v!r}" for k, v in hidden_truth(vehicle, true_seed).items()]
        nodes.start("trajectory_recorder", config=config, parameters={"metadata": metadata})
        if monitor:
            nodes.start("identification_monitor", config=config, parameters={"vehicle_file": file})
        with Operator(domain=domain, check=nodes.check) as operator:
            driven: list[str] = []  # names of the bags

            def drive(
                plan: Plan, bag: Path, progress: Progress, enough: Enough | None = None
            ) -> None:
                operator.pace(real_time_factor)
                goes_back = back is not None and bool(driven)
                operator.drive(
                    plan, bag.absolute(), progress=progress, back=goes_back, enough=enough
                )
                operator.pace(IDLE_PACE)
                driven.append(bag.name)

            yield drive
            if back is not None and driven:
                operator.pace(real_time_factor)
                _go_back(operator.go_back, back / driven[-1])


def hidden_truth(vehicle: Vehicle, true_seed: int) -> dict[str, float]:
    """Return the parameters that the simulation drives with.

    Parameters
    ----------
    vehicle : Vehicle
        Vehicle with the ranges of its unknown parameters.
    true_seed : int
        Seed of the random values; negative: the nominal values.
    """
    if true_seed < 0:
        return vehicle.nominal
    return draw_truth(vehicle, np.random.default_rng(true_seed))


@contextmanager
def running_session(
    vehicle: Vehicle | None,
    namespace: str = "",
    *,
    ask: bool = False,
    back: Path | None = None,
    pose: str = "",
) -> Iterator[DrivePlan]:
    """Drive plans on nodes of the real vehicle that run already; the operator has armed it.

    Parameters
    ----------
    vehicle : Vehicle, optional
        Vehicle for which the bridge must have been started; None: any.
    namespace : str
        Namespace of those nodes.
    ask : bool
        Whether each drive waits for a person to confirm that the vehicle is ready.
    back : Path, optional
        Makes the vehicle drive to the start of each drive by itself, and back at the end: the
        folder for the bag of this last way. Without an area somebody puts it at the first start.
    pose : str
        Topic of the poses by which the bags are read; empty: they are not read.

    Yields
    ------
    drive : DrivePlan
        Drives a plan, records its bag.

    Raises
    ------
    VehicleError
        If the bridge is another vehicle's.
    NodeError
        If there is no domain ROS_DOMAIN_ID, a node does not answer, or none publishes the poses.
    """
    from tricycle_cli.operation.operator_node import Operator

    domain = asked_domain() or 0
    with Operator(
        domain=domain, check=lambda: None, simulated=False, namespace=namespace
    ) as operator:
        # another node than the bridge may say that the vehicle is ready; it has no such parameters
        if vehicle is not None and "tricycle_bridge" in operator.publishers(TOPIC):
            check_bridge(vehicle, operator.parameters("tricycle_bridge", IDENTIFYING))
        if pose:
            operator.wait_for_poses(pose)
        driven: list[str] = []  # names of the bags

        def drive(plan: Plan, bag: Path, progress: Progress, enough: Enough | None = None) -> None:
            goes_back = back is not None and (bool(driven) or plan.area is not None)
            wait = partial(_wait_for_enter, plan, operator.preflight, goes_back)
            operator.drive(
                plan,
                bag.absolute(),
                progress=progress,
                back=goes_back,
                ask=wait if ask else None,
                enough=enough,
            )
            driven.append(bag.name)

        yield drive
        if back is not None and driven:
            service = f"{namespace}/maneuver_driver/go_back".lstrip("/")
            _go_back(operator.go_back, back / driven[-1], f"/{service}")


def _go_back(go_back: Callable[[Path], None], bag: Path, service: str = "") -> None:
    """Drive the last way back; that of a campaign's drive which is driven again is replaced.

    `service` drives it once more, where nodes are left that have it.
    """
    shutil.rmtree(bag, ignore_errors=True)
    bag.parent.mkdir(parents=True, exist_ok=True)
    try:
        go_back(bag.absolute())
    except NodeError as error:
        again = f"ros2 service call {service} std_srvs/srv/Trigger"
        advice = f"; to try again, arm the vehicle and give: {again}" if service else ""
        raise NodeError(f"{error}; all drives are recorded{advice}") from error


def _wait_for_enter(
    plan: Plan, preflight: Callable[[], Mapping[str, DiagnosticEntry]], back: bool
) -> None:
    """Show the pre-flight until nothing fails and somebody says Enter; on stderr."""
    along, across, stop = plan.space
    start = "its start"
    if plan.area is not None and plan.start_pose is not None:
        x, y, heading = plan.start_pose
        degrees = math.degrees(heading)
        start = f"x {x:.2f} m, y {y:.2f} m, heading {degrees:.1f}° in {plan.area.frame}"
    print(
        f"\n{plan.maneuver}, {plan.commands.duration:.0f} s, needs {along:.0f} m x "
        f"{across:.0f} m and {stop:.0f} m to stop, from {start}",
        file=sys.stderr,
    )
    while True:
        items = preflight()
        plain_console(stderr=True).print(diagnostics_table(items, time.monotonic()))
        # the recorder records when the drive begins, and the way back ends at the start
        later = {RECORDER, *(["start"] if back else [])}
        failing = {n for n, item in items.items() if item.level is Level.ERROR} - later
        drives = "drives back to the start and then the maneuver" if back else "drives"
        does = f"looks again ({', '.join(sorted(failing))})" if failing else drives
        print(f"Enter {does}, Ctrl-C leaves ", end="", file=sys.stderr, flush=True)
        try:
            input()
        except EOFError:
            print(file=sys.stderr)  # what is wrong has a line of its own
            raise PlanError("nobody is there to say that the vehicle is ready") from None
        if not failing:
            return
