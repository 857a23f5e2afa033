"""Faults of a rig: each does to the vehicle what the broken wire does."""

import math

import pytest

from tricycle_bridge.commands.command_stream import VehicleCommand
from tricycle_bridge.protocol.messages import Board, Fault, PlcState
from tricycle_sim.rig.emulated import EmulatedRig
from tricycle_sim.rig.faults import FaultKind, FaultPlan, RigFault
from tricycle_sim.rig.firmware import FirmwareRig
from tricycle_sim.rig.host import Host
from tricycle_sim.rig.native import NativeRig
from tricycle_sim.rig.sensors import HallSensor
from tricycle_sim.vehicle import load_vehicle

VEHICLE = load_vehicle()
STEER, DRIVE = Board.STEER, Board.DRIVE
AT = 4.0  # s: rolling at 1 m/s


@pytest.fixture(
    params=[
        "emulated",
        pytest.param("native", marks=pytest.mark.slow),
        pytest.param("firmware", marks=pytest.mark.slow),
    ]
)
def driven(request):
    """Drives at 1 m/s in a slight turn until a time, with faults."""
    rigs = []

    def drive(kind, until, *, start=AT, end=math.inf, value=0.0):
        plan = FaultPlan((RigFault(kind, start, end, value),))
        if request.param == "emulated":
            rigs.append(EmulatedRig(VEHICLE, plan))
        elif request.param == "native":
            rigs.append(NativeRig(VEHICLE, request.getfixturevalue("firmware_libraries"), plan))
        else:
            rigs.append(FirmwareRig(VEHICLE, request.getfixturevalue("firmware_images"), plan))
        host = Host(rigs[-1])
        host.arm()
        host.target = VehicleCommand(0.1, 1.0)
        host.run(until - host.rig.time)
        return host

    yield drive
    for rig in rigs:
        rig.close()


def state(host, board):
    return PlcState(host.bridge.links[board].telemetry.state)


def faults(host, board):
    return Fault(host.bridge.links[board].telemetry.faults)


@pytest.mark.parametrize("kind", [FaultKind.DRIVE_HANG, FaultKind.STEER_HANG])
def test_a_reset_forgets_what_a_hung_board_put_out(driven, kind):
    host = driven(kind, AT + 0.02)
    rig = host.rig
    assert rig.state.vx > 0.9
    assert rig.state.steering_motor_angle == pytest.approx(0.1, abs=0.01)
    rig.reset()
    host.run(0.02)
    assert rig.active_faults == {kind}
    assert rig.state.vx == pytest.approx(0.0, abs=1e-3)
    assert rig.state.steering_motor_angle == 0.0


def test_the_pulses_of_a_plant_that_diverges_are_counted_at_once():
    hall = HallSensor(0.5)
    hall.turn(1e12, 0.01, {})
    hall.turn(0.6, 0.02, {FaultKind.HALL_HALF: 0.0})
    assert hall.count == 1_000_000_000_000  # of 2e12 every second back
    assert hall.edge_at == pytest.approx(0.02)


@pytest.mark.parametrize(
    "kind", [FaultKind.HALL_OPEN, FaultKind.HALL_SHORT, FaultKind.DIRECTION_OPEN]
)
def test_a_broken_wire_of_the_hall_sensor_is_found_at_once(driven, kind):
    host = driven(kind, AT + 0.06)
    assert state(host, DRIVE) is PlcState.FAULT
    assert faults(host, DRIVE) & Fault.HALL_LINE
    host.run(2.0)
    assert abs(host.rig.state.vx) < 0.02


@pytest.mark.parametrize("kind", [FaultKind.HALL_OPEN, FaultKind.HALL_STUCK])
def test_a_sensor_that_fails_does_not_let_the_steering_go(driven, kind):
    host = driven(kind, AT)
    while state(host, DRIVE) is PlcState.ARMED:
        host.tick()
    rolls = 0
    while host.rig.state.vx > 0.05:
        host.tick()
        assert host.rig.steered
        rolls += 1
    assert rolls > 40
    host.run(10.0)
    assert not host.rig.steered


@pytest.mark.parametrize("kind", [FaultKind.STEER_RESET, FaultKind.DRIVE_RESET])
def test_a_reset_that_is_asked_for_at_any_time_resets_the_board(driven, kind):
    host = driven(FaultKind.HOST_CLOCK, AT)  # which is nothing
    host.rig.fail([kind])
    host.run(0.1)
    assert not host.bridge.armed
    assert any("rebooted" in line for line in host.log)


def test_without_pulses_the_motor_pushes_until_the_board_notices(driven):
    host = driven(FaultKind.HALL_STUCK, 0.0, start=0.0)
    host.imu = host.odometry = False
    torque = 0.0
    for _ in range(100):
        host.tick()
        torque = max(torque, host.rig.state.motor_torque)
    assert torque > 30.0
    host.run(3.0)
    assert faults(host, DRIVE) & Fault.PULSES
    assert abs(host.rig.state.vx) < 0.02


def test_with_an_imu_the_bridge_notices_a_start_without_pulses_before_it_is_fast(driven):
    host = driven(FaultKind.HALL_STUCK, 0.0, start=0.0)
    host.target = VehicleCommand(0.0, 0.0)
    host.run(0.5)
    host.target = VehicleCommand(0.0, 0.25)
    fastest = 0.0
    for _ in range(100):
        host.tick()
        fastest = max(fastest, host.rig.state.vx)
    assert "the imu has felt +0.0" in host.bridge.stopped_by
    assert fastest < 0.5
    assert abs(host.rig.state.vx) < 0.02


@pytest.mark.parametrize("odometry", [False, True])
def test_half_the_pulses_double_the_speed_unless_odometry_shows_it(driven, odometry):
    host = driven(FaultKind.HALL_HALF, 0.0, start=0.0)
    host.odometry = odometry
    host.run(6.0)
    assert host.rig.armed is not odometry
    assert host.rig.state.vx == pytest.approx(0.0 if odometry else 2.0, abs=0.1)


def test_the_stuck_direction_sensor_shows_only_when_rolling_backwards(driven):
    host = driven(FaultKind.DIRECTION_STUCK, AT + 1.0)
    assert host.rig.state.vx == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize("kind", [FaultKind.POTENTIOMETER_LOW, FaultKind.POTENTIOMETER_HIGH])
def test_a_broken_potentiometer_is_a_sensor_fault(driven, kind):
    host = driven(kind, AT + 0.1)
    assert faults(host, STEER) & Fault.SENSOR


def test_without_its_motor_the_vehicle_coasts(driven):
    host = driven(FaultKind.MOTOR_DEAD, AT + 1.0)
    assert 0.8 < host.rig.state.vx < 0.98
    assert abs(host.rig.state.motor_torque) < 1e-6


def test_without_its_brake_an_estop_does_not_brake(driven):
    host = driven(FaultKind.BRAKE_DEAD, AT + 0.1)
    host.bridge.emergency_stop(host.now)
    host.run(1.0)
    assert state(host, DRIVE) is PlcState.ESTOP
    assert host.rig.state.vx > 0.8


def test_a_servo_without_pulses_keeps_its_angle(driven):
    host = driven(FaultKind.SERVO_DEAD, AT + 0.1)
    host.target = VehicleCommand(-0.2, 1.0)
    host.run(0.3)
    assert host.rig.state.steering_motor_angle == pytest.approx(0.1, abs=0.003)


def test_the_estop_button_stops_both_boards(driven):
    host = driven(FaultKind.ESTOP, AT + 2.0)
    assert state(host, STEER) is state(host, DRIVE) is PlcState.ESTOP
    assert abs(host.rig.state.vx) < 0.02


@pytest.mark.parametrize(
    ("kind", "board"), [(FaultKind.STEER_SUPPLY, STEER), (FaultKind.DRIVE_SUPPLY, DRIVE)]
)
def test_a_board_measures_its_supply(driven, kind, board):
    host = driven(kind, AT + 0.2, value=9.0)
    assert host.bridge.links[board].telemetry.supply == pytest.approx(9000, rel=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("kind", [FaultKind.STEER_RESET, FaultKind.DRIVE_RESET])
@pytest.mark.parametrize("hangs", [False, True])
def test_a_reset_or_hanging_board_stops_the_vehicle(driven, kind, hangs):
    if hangs:
        kind = {
            FaultKind.STEER_RESET: FaultKind.STEER_HANG,
            FaultKind.DRIVE_RESET: FaultKind.DRIVE_HANG,
        }[kind]
    host = driven(kind, AT + 3.0)
    assert not host.rig.armed
    assert abs(host.rig.state.vx) < 0.02


@pytest.mark.slow
@pytest.mark.parametrize("kind", [FaultKind.STEER_CABLE, FaultKind.DRIVE_CABLE])
def test_a_pulled_cable_stops_the_vehicle_and_a_plugged_one_resets_the_board(driven, kind):
    host = driven(kind, AT + 5.0, end=AT + 3.0)
    assert not host.rig.armed
    assert abs(host.rig.state.vx) < 0.02
    board = STEER if kind is FaultKind.STEER_CABLE else DRIVE
    assert state(host, board) is PlcState.SAFE
    assert not faults(host, board) & Fault.CMD_TIMEOUT


def test_a_silent_host_trips_the_watchdogs(driven):
    host = driven(FaultKind.HOST_SILENT, AT + 3.0)
    assert not host.rig.armed
    assert abs(host.rig.state.vx) < 0.02


@pytest.mark.parametrize("step", [-3.0, 3.0])
def test_a_step_of_the_hosts_clock_is_the_hosts_alone(driven, step):
    host = driven(FaultKind.HOST_CLOCK, AT + 1.0, value=step)
    assert host.rig.time == pytest.approx(AT + 1.0)
    assert host.rig.host_time == pytest.approx(AT + 1.0 + step)
