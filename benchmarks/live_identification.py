"""Identification during a drive: its deviations beside those of the bag, and its processor time.

    python benchmarks/live_identification.py [--drives 3]

`identification_monitor` runs beside the nodes of a simulated drive of a circle, in real time.
Printed for each drive of a hidden vehicle: the processor time of the monitor from the start of the
drive to its verdict, as a share of a core; and of all parameters the least and the largest live
standard deviation at the end over that of `identify` of the bag.
"""

import argparse
import os
import tempfile
import time
from pathlib import Path

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticStatus

from excitation_planner.design.noise import SIMULATED
from excitation_planner.maneuver import Circle
from excitation_planner.plan import save_plan
from excitation_planner.planning import PlanRequest, plan_at
from parameter_identification.drives.measured_from_bag import read_measured_drive
from parameter_identification.identification import identify
from tricycle_bringup.configuration import SIMULATION_CONFIG
from tricycle_cli.operation.processes import NodeProcesses, own_domain, ros_environment
from tricycle_cli.operation.session import simulated_session
from tricycle_core.nodes import LATCHED
from tricycle_sim.vehicle import load_vehicle


def processor_time(name):
    """Time that the process of a node has taken [s]."""
    taken = 0.0
    for process in Path("/proc").glob("[0-9]*"):
        try:
            if f"/{name}\0".encode() in (process / "cmdline").read_bytes():
                fields = (process / "stat").read_text().rsplit(")", 1)[1].split()
                taken += (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
        except OSError:  # it has ended
            continue
    return taken


def driven(plan, vehicle, seed, folder, env):
    """Processor time over time, and ratios (k,) of the deviations, of a drive."""
    heard = []
    node = rclpy.create_node("live_identification")
    node.create_subscription(DiagnosticStatus, "identification/estimates", heard.append, LATCHED)

    def listen(*_):
        rclpy.spin_once(node, timeout_sec=0.0)

    with NodeProcesses(env, folder / "log") as nodes:
        plan_file = {"plan_file": str(folder / "plan.json")}
        nodes.start("identification_monitor", config=SIMULATION_CONFIG, parameters=plan_file)
        while not node.count_publishers("identification/estimates"):
            nodes.check()
            rclpy.spin_once(node, timeout_sec=0.1)
        with simulated_session(
            vehicle_file=None, noise_seed=seed, true_seed=seed, real_time_factor=1.0, folder=folder
        ) as drive:
            before, start = processor_time("identification_monitor"), time.monotonic()
            drive(plan, folder / "bag", listen)
            while not (heard and "informative" in heard[-1].message):
                nodes.check()
                rclpy.spin_once(node, timeout_sec=0.1)
            taken = processor_time("identification_monitor") - before
            share = taken / (time.monotonic() - start)
    node.destroy_node()
    live = {pair.key: pair.value for pair in heard[-1].values}
    found = identify([read_measured_drive(folder / "bag", vehicle)], vehicle).parameters
    ratios = [float(live[f"{n} std"]) / p.standard_deviation for n, p in found.items()]
    return share, np.array(ratios)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--drives", type=int, default=3)
    vehicle = load_vehicle()
    request = PlanRequest(vehicle, Circle(), "cornering_stiffness", noise=SIMULATED)
    plan = plan_at(request, np.array([2.5, 1.0]))
    for seed in range(1, parser.parse_args().drives + 1):
        with tempfile.TemporaryDirectory() as folder:
            env = ros_environment(domain=own_domain(), log_dir=Path(folder) / "ros")
            os.environ.update(env)
            rclpy.init()
            save_plan(plan, Path(folder) / "plan.json")
            share, ratios = driven(plan, vehicle, seed, Path(folder), env)
            rclpy.shutdown()
        print(
            f"vehicle {seed}: {share:.1%} of a core; live deviations {ratios.min():.2f} to "
            f"{ratios.max():.2f} times those of the bag",
            flush=True,
        )


if __name__ == "__main__":
    main()
