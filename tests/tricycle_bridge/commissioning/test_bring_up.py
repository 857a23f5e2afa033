"""The bring-up on emulated boards behind serial devices, with an engineer who does as told."""

import math
import re

import pytest

from tricycle_bridge.commissioning.bring_up import STEPS, TURNS, bring_up
from tricycle_bridge.commissioning.stand import PortStand
from tricycle_bridge.protocol.boards import HALL_PULSE
from tricycle_bridge.protocol.messages import Board
from tricycle_bridge.settings import BridgeSettings
from tricycle_sim.plc.pair import PlcPair

pytestmark = [pytest.mark.slow, pytest.mark.real_time]
SETTINGS = BridgeSettings()
PLUGS = ("Unplug", "Plug", "Pull", "Put")


class Engineer:
    """Does what the bring-up asks for; `mistakes` replaces what is done at a text."""

    def __init__(self, pair, **mistakes):
        self.pair = pair
        self.mistakes = mistakes
        self.told = []

    def __call__(self, text):
        self.told.append(text)
        for word in ("Press", "Release", "left", "right", "Turn the driven", *PLUGS):
            if word in text:
                name = word.split()[0].lower()
                self.mistakes.get(name, getattr(self, name))()

    def press(self):
        self.pair.estop_pressed = True

    def release(self):
        self.pair.estop_pressed = False

    def left(self):
        self.pair.steering_angle = 0.78

    def right(self):
        self.pair.steering_angle = -0.78

    def turn(self, turns=TURNS):
        self.pair.distance += turns * 2 * math.pi * SETTINGS.tyre_radius

    def unplug(self):
        self.pair.hall_plugged = False

    def plug(self):
        self.pair.hall_plugged = True

    def pull(self):
        self.pair.unplug(Board.DRIVE)

    def put(self):
        self.pair.plug(Board.DRIVE)


@pytest.fixture
def pair(tmp_path):
    with PlcPair(tmp_path / "steer", tmp_path / "drive") as pair:
        yield pair


def run(pair, engineer, steps=STEPS):
    paths = {Board.STEER: pair.steer_path, Board.DRIVE: pair.drive_path}
    with PortStand(paths, SETTINGS, engineer, boot_wait=0.0) as stand:
        stand.connect(5.0)
        return list(bring_up(stand, steps))


def only(name):
    return tuple(step for step in STEPS if step.name == name)


def test_every_step_passes_by_what_the_boards_measure(pair):
    results = run(pair, Engineer(pair))
    assert [r.problem for r in results] == [""] * len(STEPS)
    measured = {name: value for r in results for name, value in r.measured.items()}
    assert measured["pulses per turn"] == pytest.approx(
        2 * math.pi * SETTINGS.tyre_radius / HALL_PULSE, rel=0.01
    )
    assert measured["left end stop (rad)"] == pytest.approx(0.78, abs=0.01)
    assert measured["watchdog (s)"] < 0.4
    assert 0.0 < measured["rolled to rest (m)"] < 0.3


def test_a_hall_sensor_whose_unplugging_is_not_noticed_does_not_pass(pair, monkeypatch):
    monkeypatch.setattr("tricycle_bridge.commissioning.bring_up.BY_HAND", 0.5)
    (result,) = run(pair, Engineer(pair, unplug=lambda: None), only("hall sensor's lines"))
    assert not result.passed
    assert "did not notice it" in result.problem


def test_a_brake_that_does_not_close_does_not_pass(pair, monkeypatch):
    monkeypatch.setattr("tricycle_sim.plc.pair._BRAKING", 0.15)  # what rolling takes
    (result,) = run(pair, Engineer(pair), only("brake"))
    assert not result.passed
    assert re.search(r"rolled .* m, must be .* at most: the brake is weak", result.problem)


@pytest.mark.parametrize(
    ("turns", "message"),
    [
        (TURNS / 2, "half of the edges are lost"),
        (-TURNS, "the direction wire or two halls are exchanged"),
        (0.9 * TURNS, "must be 1380 ± 5 %"),
    ],
)
def test_a_wrong_hall_count_does_not_pass(pair, turns, message):
    engineer = Engineer(pair)
    engineer.mistakes["turn"] = lambda: engineer.turn(turns)
    (result,) = run(pair, engineer, only("hall count"))
    assert not result.passed
    assert message in result.problem


def test_a_wheel_in_the_air_does_not_pass_and_is_told_what_it_lacks(pair, monkeypatch):
    monkeypatch.setattr("tricycle_sim.plc.pair._MASS", 2.0)
    (result,) = run(pair, Engineer(pair), only("motor direction"))
    assert not result.passed
    assert "the drive PLC is FAULT (PULSES), which a wheel that turns more easily" in result.problem
