"""The emulated rig: a host that answers every tick drives exactly what the batch computes."""

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
from tricycle_sim.rig.emulated import EmulatedRig
from tricycle_sim.vehicle import load_vehicle
from tricycle_sim.vehicle.batch import simulate

VEHICLE = load_vehicle()
SESSION = 7


class Host:
    """The least that arms and drives both boards."""

    def __init__(self, rig):
        self.rig = rig
        self.seq = 0
        for board in Board.STEER, Board.DRIVE:
            self.send(board, Hello(0, board, 1))

    def send(self, board, message):
        data = encode(message, board=board, seq=self.seq & 0xFF, session=SESSION)
        self.seq += 1
        return self.rig.receive(board, data)

    def command(self, angle, speed):
        echo = echo_of(round(self.rig.time * 1e6))
        steer = SteerCommand(1, 0, round(angle / ANGLE_UNIT), 2000, echo)
        self.send(Board.STEER, steer)
        drive = DriveCommand(1, Gear.DRIVE, round(speed / SPEED_UNIT), 1000, 0, 0, echo)
        self.send(Board.DRIVE, drive)

    def arm(self):
        for board in Board.STEER, Board.DRIVE:
            self.send(board, Control.of(Op.ARM))


def armed_rig():
    rig = EmulatedRig(VEHICLE)
    rig.step()
    host = Host(rig)
    for _ in range(6):
        host.command(0.0, 0.0)
        rig.step()
    host.arm()
    assert rig.armed
    return rig, host


def test_the_live_path_with_plcs_equals_the_batch():
    rig, host = armed_rig()
    ticks = 400
    targets = [(0.2 * np.sin(0.01 * k), min(1.0, 0.01 * k)) for k in range(ticks)]
    rounded = [
        (round(a / ANGLE_UNIT) * ANGLE_UNIT, round(v / SPEED_UNIT) * SPEED_UNIT) for a, v in targets
    ]
    for angle, speed in targets:
        host.command(angle, speed)
        rig.step()
    angles, speeds = np.array(rounded).T
    batch = simulate(
        VEHICLE,
        Commands(0.01 * np.arange(ticks + 1), np.append(angles, 0), np.append(speeds, 0)),
    )
    # 10 ms steps in the batch, 5 ms live, and the armed standstill before: micrometres
    assert rig.state.x == pytest.approx(batch.x[0, -1], abs=2e-5)
    assert rig.state.y == pytest.approx(batch.y[0, -1], abs=2e-5)
    assert rig.state.yaw == pytest.approx(batch.yaw[0, -1], abs=2e-5)


def test_the_host_has_answered_when_both_boards_heard_a_command():
    rig, host = armed_rig()
    rig.step()
    assert not rig.answered
    host.command(0.0, 0.0)
    assert rig.answered
    rig.step()
    assert not rig.answered


def test_a_silent_host_stops_the_vehicle():
    rig, host = armed_rig()
    for _ in range(200):
        host.command(0.0, 1.0)
        rig.step()
    assert rig.state.vx > 0.9
    for _ in range(400):
        rig.step()
    assert not rig.armed
    assert abs(rig.state.vx) < 0.01


def test_reset_puts_the_vehicle_back_and_forgets_the_session():
    rig, host = armed_rig()
    for _ in range(100):
        host.command(0.1, 0.5)
        rig.step()
    time = rig.time
    rig.reset()
    assert (rig.state.x, rig.state.y, rig.state.vx) == (0.0, 0.0, 0.0)
    assert rig.time == time
    rig.step()
    assert not rig.armed
    host.arm()
    assert not rig.armed
