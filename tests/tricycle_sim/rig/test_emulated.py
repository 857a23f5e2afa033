"""The emulated rig: a host that answers every tick drives exactly what the batch computes."""

import numpy as np
import pytest

from tricycle_bridge.commands.command_stream import VehicleCommand
from tricycle_bridge.protocol.units import ANGLE_UNIT, SPEED_UNIT
from tricycle_sim.commands import Commands
from tricycle_sim.rig.emulated import EmulatedRig
from tricycle_sim.rig.host import Host
from tricycle_sim.vehicle import load_vehicle
from tricycle_sim.vehicle.batch import simulate

VEHICLE = load_vehicle()


def armed_rig():
    rig = EmulatedRig(VEHICLE)
    host = Host(rig)
    host.arm()
    return rig, host


def test_the_live_path_with_plcs_equals_the_batch():
    rig, host = armed_rig()
    ticks = 400
    targets = [(0.2 * np.sin(0.01 * k), min(1.0, 0.01 * k)) for k in range(ticks)]
    rounded = [
        (round(a / ANGLE_UNIT) * ANGLE_UNIT, round(v / SPEED_UNIT) * SPEED_UNIT) for a, v in targets
    ]
    for angle, speed in targets:
        host.target = VehicleCommand(angle, speed)
        host.tick()
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
    host.send()
    assert rig.answered
    rig.step()
    assert not rig.answered


def test_a_silent_host_stops_the_vehicle():
    rig, host = armed_rig()
    host.target = VehicleCommand(0.0, 1.0)
    host.run(2.0)
    assert rig.state.vx > 0.9
    for _ in range(400):
        rig.step()
    assert not rig.armed
    assert abs(rig.state.vx) < 0.01


def test_reset_puts_the_vehicle_back_and_forgets_the_session():
    rig, host = armed_rig()
    host.target = VehicleCommand(0.1, 0.5)
    host.run(1.0)
    time = rig.time
    rig.reset()
    assert (rig.state.x, rig.state.y, rig.state.vx) == (0.0, 0.0, 0.0)
    assert rig.time == time
    rig.step()
    assert not rig.armed
    host.run(0.2)
    assert not rig.armed
