"""Two simulated tricycles at once, each in a namespace with a clock of its own, on real nodes."""

import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
import yaml
from launch_recorder import launched_nodes

from excitation_planner.maneuver import Circle
from excitation_planner.maneuver.steering import StepSteer
from excitation_planner.plan import save_plan
from excitation_planner.planning import PlanRequest, plan_at
from parameter_identification.judging.judgement import judge
from trajectory_recorder.bag.reader import BagReader
from tricycle_cli.operation.operator_node import Operator
from tricycle_sim.vehicle import load_vehicle

pytestmark = [pytest.mark.ros, pytest.mark.slow]

DRIVES = {
    "first": (Circle(duration=3.0), (2.5, 1.0)),
    "second": (StepSteer(duration=3.0), (0.3, 1)),
}


@pytest.fixture(scope="module")
def plans():
    vehicle = load_vehicle()
    return {
        namespace: plan_at(
            PlanRequest(vehicle, family, "cornering_stiffness", samples=50), np.array(x)
        )
        for namespace, (family, x) in DRIVES.items()
    }


@pytest.fixture
def fleet(ros_environment, plans, tmp_path):
    """Start what simulation.launch.py starts in both namespaces; each planner has a plan already.

    It is the other tricycle's: none that is driven.
    """
    others = dict(zip(plans, reversed(plans.values()), strict=True))
    running = []
    for namespace in DRIVES:
        for node in launched_nodes("simulation.launch.py", namespace=namespace, bag=""):
            # what the launch file sets, but for ports of the test's own, speed, and who arms
            parameters = node["parameters"]
            changes = {"arm_on_activate": False, "autostart": True, "real_time_factor": 10.0}
            changes["plan_file"] = str(tmp_path / f"{namespace}.json")
            save_plan(others[namespace], Path(changes["plan_file"]))
            for port in ("steer_port", "drive_port"):
                changes[port] = str(tmp_path / namespace / port)
            parameters |= {name: changes[name] for name in parameters.keys() & changes.keys()}
            file = tmp_path / f"{namespace}_{node['executable']}.yaml"
            file.write_text(yaml.safe_dump({"/**": {"ros__parameters": parameters}}))
            arguments = ["-r", f"__ns:=/{namespace}", "--params-file", file]
            for name, own_name in node["remappings"]:
                arguments += ["-r", f"{name}:={own_name}"]
            command = [Path(sys.executable).with_name(node["executable"]), "--ros-args", *arguments]
            running.append(subprocess.Popen(command, env=ros_environment, cwd=tmp_path))

    def check():
        assert all(process.poll() is None for process in running)

    yield check
    for process in running:
        process.terminate()
    assert [process.wait(timeout=20) for process in running] == [0] * len(running)


def test_each_drives_its_own_plan_on_its_own_clock(ros_environment, fleet, plans, tmp_path):
    def drive(namespace):
        bag = tmp_path / "bags" / namespace
        domain = int(ros_environment["ROS_DOMAIN_ID"])
        with Operator(domain=domain, check=fleet, namespace=namespace) as operator:
            operator.drive(plans[namespace], bag, progress=lambda *_: None)
        return bag

    with ThreadPoolExecutor() as pool:
        bags = dict(zip(DRIVES, pool.map(drive, DRIVES), strict=True))

    for namespace, bag in bags.items():
        judgement = judge(bag)
        assert judgement.plan_id == plans[namespace].id
        # the vehicles are nominal: 1 cm of noise on the anchor and nothing else
        assert np.sqrt(max(judgement.te_corrected, 0.0)) < 5e-3
        with BagReader(bag) as reader:
            topics = set(reader.topics)
        assert {f"/{namespace}/odom", f"/{namespace}/joint_commands"} <= topics
        assert f"/{namespace}/diagnostics" in topics
        assert all(topic.startswith(f"/{namespace}/") for topic in topics), topics
