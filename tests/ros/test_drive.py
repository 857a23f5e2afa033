"""A plan driven on real nodes, processes and ptys; its bag judged; and what is left of a kill."""

import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from node_processes import node_processes
from rosbags.highlevel import AnyReader

from excitation_planner.design.information import (
    difference_points,
    information,
    posterior_covariance,
)
from excitation_planner.design.noise import SIMULATED
from excitation_planner.design.prior import BoxPrior
from excitation_planner.maneuver import Circle
from excitation_planner.plan import save_plan
from excitation_planner.planning import PlanRequest, plan_at
from excitation_planner.planning.prediction import ReplayedTrajectories
from excitation_planner.planning.replay import nominal_run, replayed_errors
from parameter_identification.drives.measured_from_bag import read_measured_drive
from parameter_identification.drives.reader import read_drive
from parameter_identification.estimation.inputs import Inputs
from parameter_identification.identification import identify
from parameter_identification.judging.judgement import judge
from trajectory_recorder.bag.reader import BagReader
from tricycle_cli.operation.session import simulated_session
from tricycle_core.errors import NodeError
from tricycle_core.nodes import LATCHED
from tricycle_sim.vehicle import draw_truth, load_vehicle

pytestmark = [pytest.mark.ros, pytest.mark.slow]

X = np.array([2.5, 1.0])
TRUE_SEED = 3


@pytest.fixture(scope="module")
def request_():
    circle = Circle(duration=6.0)
    return PlanRequest(load_vehicle(), circle, "cornering_stiffness", samples=50, noise=SIMULATED)


@pytest.fixture(scope="module")
def plan(request_):
    return plan_at(request_, X)


def forecast(request, truth):
    """Standard deviations that plans expect where the vehicle is this one, not one of the box."""
    low, high = np.array(list(request.vehicle.unknown.values())).T
    k = len(truth)
    there = BoxPrior((truth - low) / (high - low), 1e-12 * np.eye(k))
    U = difference_points(k, 1, seed=0, prior=there)
    f = ReplayedTrajectories(request.vehicle, request.family, request.noise.channels)
    F = information(U, f(X, low + (high - low) * U), request.noise.of_trajectory)
    std = (high - low) * np.sqrt(np.diag(posterior_covariance(F)[0]))
    return dict(zip(request.vehicle.unknown, std, strict=True))


def test_a_driven_plan_has_the_trajectory_error_of_the_true_vehicle(
    ros_environment, request_, plan, tmp_path
):
    reports = []
    with simulated_session(
        vehicle_file=None, noise_seed=1, true_seed=TRUE_SEED, real_time_factor=10.0, folder=tmp_path
    ) as drive:
        drive(plan, tmp_path / "bag", lambda *report: reports.append(report))
    truth = draw_truth(request_.vehicle, np.random.default_rng(TRUE_SEED))
    run = nominal_run(request_.vehicle, request_.family, X)
    expected = replayed_errors(request_.vehicle, run, np.array([list(truth.values())]))[0]
    judgement = judge(tmp_path / "bag")
    assert judgement.plan_id == plan.id
    # rms deviations in m: the noise of the anchor is a millimetre and a fraction of a mrad
    assert np.sqrt(judgement.te_corrected) == pytest.approx(np.sqrt(expected), abs=3e-3)
    with BagReader(tmp_path / "bag") as bag:
        record = bag.metadata
    assert record["plan_id"] == plan.id
    assert record["vehicle_hash"] == plan.vehicle_hash
    assert {"software_version", "firmware_steer", "firmware_drive"} <= record.keys()
    # on a busy machine a command comes some ticks of the fast clock late, and the wheels would move
    # the model as they were measured; the plan counts on the commands
    driven = read_measured_drive(tmp_path / "bag", request_.vehicle)
    found = identify([driven], request_.vehicle, inputs=Inputs.COMMANDS)
    for name, std in forecast(request_, np.array(list(truth.values()))).items():
        deviation = found.parameters[name].standard_deviation
        assert deviation == pytest.approx(std, rel=0.25), (name, found.noise)
    assert reports[-1] == (round(1e3 * plan.commands.duration),) * 2
    with AnyReader([tmp_path / "bag"]) as reader:
        topics = {connection.topic for connection in reader.connections}
        stamps = _stamps(reader, "/odom")
    assert topics >= {
        *("/maneuver/path", "/maneuver/commands", "/maneuver/reference", "/maneuver/state"),
        *("/odom", "/imu", "/joint_states", "/joint_commands", "/diagnostics"),
    }
    assert np.all(np.diff(stamps) == 1)  # every tick of the simulated clock, none lost


def test_three_drives_of_a_session_of_which_a_paused_recorder_misses_nothing(
    ros_environment, ros_node, plan, tmp_path, capfd
):
    """What the monitor learns ends none; one is recorded late; the last one is interrupted."""
    estimates = ros_node.create_publisher(DiagnosticStatus, "identification/estimates", LATCHED)
    values = {"known": "true", "plan_id": plan.id}
    message = DiagnosticStatus(values=[KeyValue(key=k, value=v) for k, v in values.items()])
    held = []

    def hold_up(elapsed, _duration):  # from 1 to 4 s
        if elapsed > 1000 and not held:
            held.extend(node_processes(tmp_path, "trajectory_recorder"))
            os.kill(held[0], signal.SIGSTOP)
        elif elapsed > 4000:
            os.kill(held[0], signal.SIGCONT)

    def interrupt(elapsed, _duration):
        if elapsed > 0:
            raise KeyboardInterrupt

    with (
        suppress(KeyboardInterrupt),
        simulated_session(
            vehicle_file=None, true_seed=0, real_time_factor=10.0, folder=tmp_path
        ) as drive,
    ):
        drive(plan, tmp_path / "learned", lambda *_: estimates.publish(message))
        try:
            drive(plan, tmp_path / "paused", hold_up)
        finally:
            for recorder in held:
                os.kill(recorder, signal.SIGCONT)
        assert held
        drive(plan, tmp_path / "interrupted", interrupt)
    assert "the vehicle is stopped and recorded for 5 s more" in capfd.readouterr().err
    # it has not asked for it
    assert read_drive(tmp_path / "learned").ended_early is None
    start = read_drive(tmp_path / "paused", sensors=False).start // 10_000_000
    with AnyReader([tmp_path / "paused"]) as reader:
        for topic in ("/odom", "/imu", "/joint_states", "/joint_commands"):
            stamps = np.sort(_stamps(reader, topic)) - start
            driven = stamps[(stamps >= 0) & (stamps <= 600)]
            # on a busy machine the nodes themselves leave out some ticks of so fast a simulation
            assert np.diff(driven, prepend=0, append=600).max() < 30, topic


DYING = """
from tricycle_sim.plants.own import OwnPlant


class Dying(OwnPlant):
    def hold_speed(self, tick, steering, speed, brake):
        state = super().hold_speed(tick, steering, speed, brake)
        if state.x**2 + state.y**2 > 1.0:
            raise RuntimeError("out of fuel")
        return state
"""


def test_a_plant_that_dies_ends_the_drive_with_its_line_and_the_bag_is_closed(
    ros_environment, install_distribution, plan, tmp_path, monkeypatch
):
    install_distribution(
        "tricycle_sim.plants", "hearse", "hearse", DYING, {"hearse": "hearse:Dying"}
    )
    paths = f"{tmp_path}{os.pathsep}{os.environ.get('PYTHONPATH', '')}"
    monkeypatch.setenv("PYTHONPATH", paths)
    with (
        pytest.raises(NodeError, match=r"plant Dying at \d+\.\d+ s: RuntimeError\('out of fuel'\)"),
        simulated_session(
            vehicle_file=None, true_seed=0, real_time_factor=10.0, folder=tmp_path, plant="hearse"
        ) as drive,
    ):
        drive(plan, tmp_path / "bag", lambda *_: None)
    with BagReader(tmp_path / "bag") as bag:
        assert not any(name.startswith("true_") for name in bag.metadata)


EMPTY_BAG = 10_000  # bytes; a bag begins with its header and metadata, without a message


@pytest.mark.parametrize("end", [signal.SIGINT, signal.SIGHUP, signal.SIGKILL])
def test_an_interrupted_drive_leaves_a_readable_bag_and_no_process(
    ros_environment, plan, tmp_path, end
):
    save_plan(plan, tmp_path / "plan.json")
    command = [str(Path(sys.executable).with_name("tricycle")), "drive", "plan.json"]
    process = subprocess.Popen(
        [*command, "--bag", "bag", "--real-time-factor", "2"],
        cwd=tmp_path,
        env=ros_environment,
        stderr=subprocess.PIPE,
        text=True,
    )
    deadline = time.monotonic() + 90
    while not any(bag.stat().st_size > EMPTY_BAG for bag in tmp_path.glob("bag/*.mcap")):
        assert process.poll() is None, process.stderr.read()
        assert time.monotonic() < deadline
        time.sleep(0.05)
    process.send_signal(end)
    _, errors = process.communicate(timeout=30)
    assert "Traceback" not in errors
    if end == signal.SIGKILL:  # the nodes hear of it from the kernel
        while node_processes(tmp_path):
            assert time.monotonic() < deadline, node_processes(tmp_path)
            time.sleep(0.05)
    else:
        assert process.returncode == 130
        assert errors.rstrip().endswith("tricycle: interrupted")
    assert node_processes(tmp_path) == []
    with AnyReader([tmp_path / "bag"]) as reader:
        assert sum(1 for _ in reader.messages()) > 0


def _stamps(reader, topic):
    """Stamps of a topic's messages in ticks, in the order of recording."""
    connections = [c for c in reader.connections if c.topic == topic]
    stamps = [
        reader.deserialize(raw, connection.msgtype).header.stamp
        for connection, _, raw in reader.messages(connections)
    ]
    return [stamp.sec * 100 + stamp.nanosec // 10_000_000 for stamp in stamps]
