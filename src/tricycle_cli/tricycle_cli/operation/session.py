"""A simulated session: the nodes of a run as processes, and plans driven on them."""

import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from excitation_planner.plan import Plan
from tricycle_bringup.configuration import SIMULATION_CONFIG, bridge_parameters
from tricycle_cli.operation.processes import NodeProcesses, own_domain, ros_environment
from tricycle_core.errors import BagError
from tricycle_core.quantities import Progress
from tricycle_sim.vehicle import Vehicle, draw_truth, load_vehicle


@contextmanager
def simulated_session(
    *,
    vehicle_file: str,
    true_seed: int,
    real_time_factor: float,
    folder: Path,
    firmware: Path | None = None,
) -> Iterator[Callable[[Plan, Path, Progress], None]]:
    """Start simulation, bridge, driver and recorder; end them all with the block.

    Parameters
    ----------
    vehicle_file
        Vehicle YAML; empty for the packaged tricycle.
    true_seed
        Of the hidden true parameters.
    real_time_factor
        Largest ratio of simulated to wall time; an armed simulation also waits for its host.
    folder
        For logs and the ptys' links.
    firmware
        Build of the real firmware to run on simulated UNOs; None: emulated PLCs.

    Yields
    ------
    drive
        `drive(plan, bag, progress)` resets the simulation, drives the plan, records the bag.

    Raises
    ------
    NodeError
        If a node cannot be started or ends by itself.
    """
    # imported here: without ROS the rest of the command line works
    from tricycle_cli.operation.operator_node import Operator

    domain = int(os.environ.get("ROS_DOMAIN_ID", own_domain()))
    env = ros_environment(domain=domain, log_dir=(folder / "log" / "ros").absolute())
    os.environ.update(env)
    ports = {
        "steer_port": str((folder / "steer").absolute()),
        "drive_port": str((folder / "drive").absolute()),
    }
    with NodeProcesses(env, folder / "log") as nodes:
        config = SIMULATION_CONFIG
        nodes.start(
            "tricycle_sim",
            config=config,
            parameters={
                **ports,
                "vehicle_file": vehicle_file,
                "true_seed": true_seed,
                "real_time_factor": real_time_factor,
                **({"plc": "firmware", "firmware": str(firmware.absolute())} if firmware else {}),
            },
        )
        nodes.start(
            "tricycle_bridge",
            config=config,
            parameters={**ports, **bridge_parameters(vehicle_file), "arm_on_activate": False},
        )
        nodes.start("maneuver_driver", config=config, parameters={})
        vehicle = load_vehicle(Path(vehicle_file) if vehicle_file else None)
        told = [f"vehicle={vehicle.name}", f"vehicle_hash={vehicle.fingerprint}"]
        told += [f"true_{k}={v!r}" for k, v in _hidden_truth(vehicle, true_seed).items()]
        nodes.start("trajectory_recorder", config=config, parameters={"metadata": told})
        with Operator(domain=domain, check=nodes.check) as operator:

            def drive(plan: Plan, bag: Path, progress: Progress) -> None:
                operator.drive(plan, bag.absolute(), progress=progress)

            yield drive


def _hidden_truth(vehicle: Vehicle, true_seed: int) -> dict[str, float]:
    """What the simulation draws: for the bag's record, so that estimates can be judged by it."""
    if true_seed < 0:
        return vehicle.nominal
    return draw_truth(vehicle, np.random.default_rng(true_seed))


@contextmanager
def running_session(namespace: str = "") -> Iterator[Callable[[Plan, Path, Progress], None]]:
    """Drive plans on nodes that run already, of the real vehicle; arming stays the operator's.

    Parameters
    ----------
    namespace
        Of those nodes.

    Yields
    ------
    drive
        `drive(plan, bag, progress)` drives the plan and records the bag.
    """
    from tricycle_cli.operation.operator_node import Operator

    domain = int(os.environ.get("ROS_DOMAIN_ID", "0"))
    with Operator(
        domain=domain, check=lambda: None, simulated=False, namespace=namespace
    ) as operator:

        def drive(plan: Plan, bag: Path, progress: Progress) -> None:
            operator.drive(plan, bag.absolute(), progress=progress)

        yield drive


def make_room(folder: Path, *, overwrite: bool) -> None:
    """Make an output folder, empty of an earlier run's bags.

    Raises
    ------
    BagError
        If bags are there already and are not to be overwritten.
    """
    bags = folder / "bags"
    if bags.exists() and any(bags.iterdir()):
        if not overwrite:
            raise BagError(f"{bags}: holds bags already; choose another --output or --overwrite")
        shutil.rmtree(bags)
    folder.mkdir(parents=True, exist_ok=True)
