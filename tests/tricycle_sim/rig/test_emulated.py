"""The simulator: a host that answers every tick drives exactly what the batch computes."""

import numpy as np
import pytest

from tricycle_bridge.protocol.framing import encode
from tricycle_bridge.protocol.messages import (
    ANGLE_UNIT,
    SPEED_UNIT,
    Board,
    Control,
    DriveCommand,
    Gear,
    Hello,
    Op,
    SteerCommand,
    echo_of,
)
from tricycle_sim.commands import Commands
from tricycle_sim.rig.emulated import PoseNoise, Simulator, draw_truth, measure_pose
from tricycle_sim.vehicle import load_vehicle
from tricycle_sim.vehicle.batch import simulate

VEHICLE = load_vehicle()
SESSION = 7


class Host:
    """The least that arms and drives both boards."""

    def __init__(self, simulator):
        self.simulator = simulator
        self.seq = 0
        for board in Board.STEER, Board.DRIVE:
            self.send(board, Hello(0, board, 1))

    def send(self, board, message):
        data = encode(message, board=board, seq=self.seq & 0xFF, session=SESSION)
        self.seq += 1
        return self.simulator.receive(board, data)

    def command(self, angle, speed):
        echo = echo_of(round(self.simulator.time * 1e6))
        steer = SteerCommand(1, 0, round(angle / ANGLE_UNIT), 2000, echo)
        self.send(Board.STEER, steer)
        drive = DriveCommand(1, Gear.DRIVE, round(speed / SPEED_UNIT), 1000, 0, 0, echo)
        self.send(Board.DRIVE, drive)

    def arm(self):
        for board in Board.STEER, Board.DRIVE:
            self.send(board, Control.of(Op.ARM))


def armed_simulator():
    simulator = Simulator(VEHICLE)
    simulator.step()
    host = Host(simulator)
    for _ in range(6):
        host.command(0.0, 0.0)
        simulator.step()
    host.arm()
    assert simulator.armed
    return simulator, host


def test_the_live_path_with_plcs_equals_the_batch():
    simulator, host = armed_simulator()
    ticks = 400
    targets = [(0.2 * np.sin(0.01 * k), min(1.0, 0.01 * k)) for k in range(ticks)]
    rounded = [
        (round(a / ANGLE_UNIT) * ANGLE_UNIT, round(v / SPEED_UNIT) * SPEED_UNIT) for a, v in targets
    ]
    for angle, speed in targets:
        host.command(angle, speed)
        simulator.step()
    angles, speeds = np.array(rounded).T
    batch = simulate(
        VEHICLE,
        Commands(0.01 * np.arange(ticks + 1), np.append(angles, 0), np.append(speeds, 0)),
    )
    # 10 ms steps in the batch, 5 ms live, and the armed standstill before: micrometres
    assert simulator.state.x == pytest.approx(batch.x[0, -1], abs=2e-5)
    assert simulator.state.y == pytest.approx(batch.y[0, -1], abs=2e-5)
    assert simulator.state.yaw == pytest.approx(batch.yaw[0, -1], abs=2e-5)


def test_the_host_has_answered_when_both_boards_heard_a_command():
    simulator, host = armed_simulator()
    simulator.step()
    assert not simulator.answered
    host.command(0.0, 0.0)
    assert simulator.answered
    simulator.step()
    assert not simulator.answered


def test_a_silent_host_stops_the_vehicle():
    simulator, host = armed_simulator()
    for _ in range(200):
        host.command(0.0, 1.0)
        simulator.step()
    assert simulator.state.vx > 0.9
    for _ in range(400):
        simulator.step()
    assert not simulator.armed
    assert abs(simulator.state.vx) < 0.01


def test_reset_puts_the_vehicle_back_and_forgets_the_session():
    simulator, host = armed_simulator()
    for _ in range(100):
        host.command(0.1, 0.5)
        simulator.step()
    time = simulator.time
    simulator.reset()
    assert (simulator.state.x, simulator.state.y, simulator.state.vx) == (0.0, 0.0, 0.0)
    assert simulator.time == time
    simulator.step()
    assert not simulator.armed
    host.arm()
    assert not simulator.armed


def test_truth_is_drawn_from_the_ranges_and_the_seed():
    draws = [draw_truth(VEHICLE, np.random.default_rng(seed)) for seed in range(200)]
    assert draws[5] == draw_truth(VEHICLE, np.random.default_rng(5))
    for name, (low, high) in VEHICLE.unknown.items():
        values = np.array([draw[name] for draw in draws])
        assert low <= values.min() < low + 0.05 * (high - low)
        assert high - 0.05 * (high - low) < values.max() <= high


def test_measured_poses_scatter_as_the_noise_says():
    state, rng = Simulator(VEHICLE).state, np.random.default_rng(0)
    poses = [measure_pose(state, PoseNoise(position=0.02, yaw=0.01), rng) for _ in range(4000)]
    assert np.std([pose.x for pose in poses]) == pytest.approx(0.02, rel=0.05)
    assert np.std([pose.yaw for pose in poses]) == pytest.approx(0.01, rel=0.05)
    assert np.mean([pose.y for pose in poses]) == pytest.approx(0.0, abs=0.002)
