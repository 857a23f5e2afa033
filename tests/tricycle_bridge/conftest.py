"""Both emulated boards behind the bridge on a simulated clock."""

import random

import pytest

from tricycle_bridge.bridge import Bridge
from tricycle_bridge.commands.command_stream import Source, VehicleCommand
from tricycle_bridge.protocol.boards import HALL_PULSE
from tricycle_bridge.protocol.messages import Board, PlcState
from tricycle_bridge.settings import BridgeSettings
from tricycle_core.diagnostics import Level
from tricycle_sim.plc import DriveMeasurement, DrivePlc, SteerMeasurement, SteerPlc

STEER, DRIVE = Board.STEER, Board.DRIVE
MASS = BridgeSettings().mass  # kg


class Vehicle:
    """Both boards on perfect cables, a perfect plant, a commander; 10 ms per step."""

    def __init__(self, **settings):
        self.bridge = Bridge(BridgeSettings(**settings), rng=random.Random(0))
        self.bridge.active = True
        self.plcs = {STEER: SteerPlc(), DRIVE: DrivePlc()}
        self.measured = {STEER: SteerMeasurement(), DRIVE: DriveMeasurement()}
        self.travel = 0.0  # m
        self.cut = set()  # boards whose cable is cut
        self.now = 1000.0
        self.target = (0.0, 0.0)  # rad, m/s; None: no commander
        self.servo_on = False
        self.outcomes = []
        self.readings = []
        self.warnings = []
        self.commands = {STEER: 0, DRIVE: 0}
        for board, plc in self.plcs.items():
            plc.tick(0, self.measured[board])
            self.bridge.opened(board, self.now)
        self.step(20)

    def step(self, ticks=1):
        for _ in range(ticks):
            self.now += 0.01
            now_us = round((self.now - 1000.0) * 1e6)
            answers = {}
            if self.target is not None:
                self.bridge.set_command(
                    VehicleCommand(*self.target),
                    stamp=self.now,
                    now=self.now,
                    source=Source.JOINT_COMMANDS,
                    name="/driver",
                )
            self.bridge.poll(self.now)
            for board, frames in self.bridge.take_frames().items():
                self.commands[board] += sum(len(f) > 17 for f in frames)  # set-points are long
                data = b"" if board in self.cut else b"".join(frames)
                answers[board] = self.plcs[board].receive(data, now_us)
            for board, plc in self.plcs.items():
                data, output = plc.tick(now_us, self.measured[board])
                self._move(board, output)
                if board not in self.cut:
                    self.bridge.receive(board, answers[board] + data, self.now)
            self.readings += self.bridge.take_readings()
            log = self.bridge.take_log()
            self.warnings += [entry.text for entry in log if entry.level is Level.WARN]

    def _move(self, board, output):
        if board is STEER:
            self.servo_on = output.servo_on
            if output.servo_on:
                self.measured[STEER] = SteerMeasurement(output.setpoint)
        else:
            speed = output.setpoint if output.motor_on else 0.0
            gain = speed - self.measured[DRIVE].speed
            self.travel += 0.01 * speed
            self.measured[DRIVE] = DriveMeasurement(
                speed, int(self.travel / HALL_PULSE), MASS * 0.335 * gain / 0.01
            )

    def until_stopped(self):
        for _ in range(2000):
            if {PlcState.ARMED, PlcState.STOPPING}.isdisjoint(p.state for p in self.plcs.values()):
                return
            self.step()
        raise AssertionError("the boards do not stop")

    def arm(self):
        before = len(self.outcomes)
        self.bridge.arm(self.now, self.outcomes.append)
        self.step(30)
        while len(self.outcomes) == before:  # the sequence has a time limit
            self.step()
        return self.outcomes[-1]

    def state(self, board):
        return self.plcs[board].state


@pytest.fixture(scope="session")
def new_vehicle():
    """Makes a vehicle, for tests that need several."""
    return Vehicle


@pytest.fixture
def vehicle():
    return Vehicle()


@pytest.fixture
def driving():
    vehicle = Vehicle()
    assert vehicle.arm() == (True, "armed")
    vehicle.target = (0.2, 1.0)
    vehicle.step(150)
    assert vehicle.measured[DRIVE].speed == pytest.approx(1.0)
    assert vehicle.measured[STEER].angle == pytest.approx(0.2)
    return vehicle
