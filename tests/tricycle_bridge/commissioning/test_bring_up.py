"""The bring-up on emulated boards behind serial devices, with an engineer who does as told."""

import math
import re
from dataclasses import replace
from importlib.resources import files

import pytest

from tricycle_bridge.commissioning.bring_up import STEPS, TURNS, bring_up
from tricycle_bridge.commissioning.record import read_record
from tricycle_bridge.commissioning.stand import PortStand
from tricycle_bridge.protocol.boards import HALL_PULSE
from tricycle_bridge.protocol.messages import Board
from tricycle_bridge.settings import BridgeSettings
from tricycle_bringup.configuration import bridge_settings
from tricycle_cli.main import main
from tricycle_sim.plc.drive import DriveMeasurement, DrivePlc
from tricycle_sim.plc.pair import PlcPair
from tricycle_sim.plc.steer import SteerMeasurement
from tricycle_sim.vehicle import load_vehicle

pytestmark = [pytest.mark.slow, pytest.mark.real_time]
SETTINGS = BridgeSettings()
PLUGS = ("Unplug", "Plug", "Pull", "Put")


class Engineer:
    """Does what the bring-up asks for; `mistakes` replaces what is done at a text."""

    def __init__(self, pair, *, tyre_radius=SETTINGS.tyre_radius, end_stop=0.78, **mistakes):
        self.pair = pair
        self.tyre_radius = tyre_radius
        self.end_stop = end_stop
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
        self.pair.steering_angle = self.end_stop

    def right(self):
        self.pair.steering_angle = -self.end_stop

    def turn(self, turns=TURNS):
        self.pair.distance += turns * 2 * math.pi * self.tyre_radius

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


def run(pair, engineer, steps=STEPS, settings=SETTINGS):
    paths = {Board.STEER: pair.steer_path, Board.DRIVE: pair.drive_path}
    with PortStand(paths, settings, engineer, boot_wait=0.0) as stand:
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


@pytest.mark.parametrize("name", ["cargo_tadpole", "car_1_10"])
def test_another_vehicle_passes_by_its_own_values(pair, monkeypatch, tmp_path, name):
    file = files("tricycle_sim") / f"{name}.yaml"
    vehicle = load_vehicle(file)
    settings = bridge_settings(vehicle)
    behind = {
        "_MASS": settings.mass,
        "HALL_PULSE": settings.hall_pulse,
        "TYRE_RADIUS": settings.tyre_radius,
    }
    for constant, value in behind.items():
        monkeypatch.setattr(f"tricycle_sim.plc.pair.{constant}", value)
    radius, end_stop = settings.tyre_radius, vehicle.steering_limit
    engineer = Engineer(pair, tyre_radius=radius, end_stop=end_stop)

    class EngineersStand(PortStand):
        def __init__(self, paths, settings, _say, **options):
            super().__init__(paths, settings, engineer, **options)

    monkeypatch.setattr("tricycle_bridge.commissioning.stand.PortStand", EngineersStand)
    record = tmp_path / "record.json"
    options = ["--engineer", "A. Test", "--boot-wait", "0", "--record", str(record)]
    ports = [pair.steer_path, pair.drive_path]
    main(["plc", "check", *ports, "--vehicle", str(file), *options])
    written = read_record(record)
    assert [step.problem for step in written.steps] == [""] * len(STEPS)
    assert written.complete
    measured = {name: value for step in written.steps for name, value in step.measured.items()}
    assert measured["left end stop (rad)"] == pytest.approx(end_stop, abs=0.01)
    assert measured["servo left (rad)"] == pytest.approx(
        0.95 * settings.max_steering_angle, abs=0.01
    )


def test_a_servo_that_turns_by_little_passes_with_the_right_sign_only(pair, monkeypatch):
    small = replace(SETTINGS, max_steering_angle=0.03)
    step = only("servo centre and ends")
    (result,) = run(pair, Engineer(pair), step, small)
    assert result.passed
    monkeypatch.setattr(
        "tricycle_sim.plc.pair.SteerMeasurement",
        lambda angle, **named: SteerMeasurement(-angle, **named),
    )
    (result,) = run(pair, Engineer(pair), step, small)
    assert "sign of the potentiometer" in result.problem


def test_the_wheel_turns_no_faster_than_the_vehicle_may(pair):
    (result,) = run(pair, Engineer(pair), only("motor direction"), replace(SETTINGS, max_speed=0.3))
    assert result.passed
    assert result.measured["forward (m/s)"] == pytest.approx(0.3, abs=0.07)


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


def nothing():
    """What an engineer does who does not do it."""


@pytest.mark.parametrize(
    ("step", "word", "done", "message"),
    [
        ("emergency stop", "press", nothing, "not both boards saw the emergency stop within"),
        ("emergency stop", "release", nothing, "not both boards saw it released within"),
        ("steering sensor", "left", nothing, "rad ± 10 % (left is positive)"),
        ("cable pulled", "pull", nothing, "the link to the drive PLC stayed up within"),
        ("cable pulled", "put", nothing, "the drive PLC did not come back"),
    ],
)
def test_what_the_boards_do_not_see_does_not_pass(pair, monkeypatch, step, word, done, message):
    monkeypatch.setattr("tricycle_bridge.commissioning.bring_up.BY_HAND", 0.5)
    (result,) = run(pair, Engineer(pair, **{word: done}), only(step))
    assert not result.passed
    assert message in result.problem


@pytest.mark.parametrize(
    ("step", "measurement", "measured", "message"),
    [
        (
            "links, set-up and supply",
            SteerMeasurement,
            lambda it: replace(it, supply=4.0),
            "the steer PLC's supply is 4.0 V",
        ),
        (
            "servo centre and ends",
            SteerMeasurement,
            lambda it: replace(it, angle=it.angle + 0.12),
            "servo centre: +0.120 rad, must be +0.000",
        ),
        (
            "servo centre and ends",
            SteerMeasurement,
            lambda it: replace(it, angle=-it.angle),
            "sign of the potentiometer",
        ),
        (
            "motor direction",
            DriveMeasurement,
            lambda it: replace(it, hall_count=-it.hall_count),
            "the drive PLC is FAULT (PULSES)",
        ),
    ],
)
def test_what_the_boards_measure_wrongly_does_not_pass(
    pair, monkeypatch, step, measurement, measured, message
):
    monkeypatch.setattr(
        f"tricycle_sim.plc.pair.{measurement.__name__}",
        lambda *values, **named: measured(measurement(*values, **named)),
    )
    (result,) = run(pair, Engineer(pair), only(step))
    assert not result.passed
    assert message in result.problem


@pytest.mark.parametrize(
    ("step", "method", "message"),
    [
        ("watchdog", "_check_watchdog", "without commands the drive PLC tripped after"),
        ("emergency stop by the host", "_estop", "ESTOP did not stop both boards"),
    ],
)
def test_a_board_that_does_not_stop_does_not_pass(pair, monkeypatch, step, method, message):
    monkeypatch.setattr(DrivePlc, method, lambda *_: None)
    (result,) = run(pair, Engineer(pair), only(step))
    assert not result.passed
    assert message in result.problem
