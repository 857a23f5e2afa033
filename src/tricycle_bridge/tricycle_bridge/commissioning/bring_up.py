"""Bring-up of two boards on a vehicle that stands in its place, step by step.

The steered wheels are off the ground; the driven wheel stands on rollers as heavy to turn as the
vehicle, whose mass the drive board knows. Each step asks the engineer for something or moves an
actuator, and passes only by what the boards measure.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from tricycle_bridge.commands.command_stream import INPUT_AGE
from tricycle_bridge.commissioning.record import StepResult
from tricycle_bridge.commissioning.stand import PortStand
from tricycle_bridge.protocol.boards import AT_REST
from tricycle_bridge.protocol.limits import WATCHDOG
from tricycle_bridge.protocol.messages import (
    Board,
    DriveState,
    Fault,
    PlcState,
    StateFlag,
    SteerState,
)
from tricycle_bridge.protocol.readable import fault_names, state_name
from tricycle_bridge.protocol.units import (
    ANGLE_UNIT,
    LENGTH_UNIT,
    SPEED_UNIT,
    TRAVEL_UNIT,
    VOLTAGE_UNIT,
)
from tricycle_core.errors import LinkError
from tricycle_core.stopping import Cause, stopping_distance

TURNS = 10
"""Turns of the wheel by hand that the hall count is checked with."""

BY_HAND = 60.0
"""Time for what the engineer is asked to do [s]."""

STANDING = (
    "the steered wheels are off the ground, the driven wheel is on rollers as heavy to turn as the "
    "vehicle"
)
"""How the vehicle stands during the bring-up."""

_SPEED = 0.5  # m/s at which the driven wheel turns on its rollers, if the vehicle may
_TRACKING = 0.05  # rad that the servo may be off, less where it turns by little
_LIGHT = ", which a wheel that turns more easily than the vehicle gives too: is it on its rollers?"
_REACTION = 0.06  # s in which a board must react, telemetry included


class CheckFailedError(LinkError):
    """A step did not pass; the text says what was measured and what would be right."""


@dataclass(frozen=True)
class Step:
    """A step of the bring-up.

    Attributes
    ----------
    name : str
        What the step checks.
    run : callable
        Takes the stand, returns the measured values, raises `CheckFailedError`.
    """

    name: str
    run: Callable[[PortStand], dict[str, float | str]]


def _require(holds: bool, text: str) -> None:
    if not holds:
        raise CheckFailedError(text)


def _by_hand(stand: PortStand, request: str, until: Callable[[], bool], failure: str) -> None:
    stand.say(request)
    _require(stand.wait(BY_HAND, until), f"{failure} within {BY_HAND:g} s")


def _both(stand: PortStand, state: PlcState) -> Callable[[], bool]:
    return lambda: stand.steer.state == state and stand.drive.state == state


def _speed(stand: PortStand) -> float:
    return stand.drive.speed * SPEED_UNIT


def _speed_on_rollers(stand: PortStand) -> float:
    return min(_SPEED, stand.settings.max_speed)


def _angle(stand: PortStand) -> float:
    return stand.steer.angle * ANGLE_UNIT


def _check_links(stand: PortStand) -> dict[str, float | str]:
    for name, state in (("steer", stand.steer), ("drive", stand.drive)):
        _require(bool(state.flags & StateFlag.SET_UP), f"the {name} PLC has no set-up")
        volts = state.supply * VOLTAGE_UNIT
        _require(not state.faults & Fault.SUPPLY, f"the {name} PLC's supply is {volts:.1f} V")
    return {
        "steer firmware": stand.firmware(Board.STEER),
        "drive firmware": stand.firmware(Board.DRIVE),
        "steer supply (V)": stand.steer.supply * VOLTAGE_UNIT,
        "drive supply (V)": stand.drive.supply * VOLTAGE_UNIT,
    }


def _check_emergency_stop(stand: PortStand) -> dict[str, float | str]:
    def pressed(state: SteerState | DriveState) -> bool:
        return bool(state.flags & StateFlag.ESTOP_PRESSED)

    _by_hand(
        stand,
        "Press the emergency stop.",
        lambda: pressed(stand.steer) and pressed(stand.drive),
        "not both boards saw the emergency stop",
    )
    _require(
        stand.wait(_REACTION, _both(stand, PlcState.ESTOP)), "a board did not go to ESTOP at once"
    )
    _by_hand(
        stand,
        "Release the emergency stop.",
        lambda: not pressed(stand.steer) and not pressed(stand.drive),
        "not both boards saw it released",
    )
    _require(_both(stand, PlcState.ESTOP)(), "a board left ESTOP by itself")
    stand.clear()
    _require(stand.wait(1.0, _both(stand, PlcState.SAFE)), "CLEAR did not lead to SAFE")
    return {}


def _check_steering_sensor(stand: PortStand) -> dict[str, float | str]:
    reached: dict[str, float | str] = {}
    low, high = 0.9 * stand.end_stop, 1.1 * stand.end_stop
    for side, sign in (("left", 1.0), ("right", -1.0)):
        _by_hand(
            stand,
            f"Turn the steering by hand to its {side} end stop.",
            lambda sign=sign: low <= sign * _angle(stand) <= high,  # type: ignore[misc]
            f"the potentiometer did not show {sign * stand.end_stop:+.2f} rad ± 10 % "
            f"({side} is {'positive' if sign > 0 else 'negative'})",
        )
        reached[f"{side} end stop (rad)"] = _angle(stand)
    return reached


def _check_hall_lines(stand: PortStand) -> dict[str, float | str]:
    def broken() -> bool:
        return bool(stand.drive.faults & Fault.HALL_LINE)

    _require(
        not broken(), "a line of the hall sensor is outside of its bands: its resistors, A2, A3"
    )
    _by_hand(
        stand,
        "Unplug the hall sensor.",
        broken,
        "the drive PLC did not notice it (resistors at the board's end of the cable?)",
    )
    stand.say("Plug the hall sensor in again.")

    def mended() -> bool:
        stand.clear()
        return stand.wait(0.2, lambda: not broken())

    _require(stand.wait(BY_HAND, mended), f"HALL_LINE stayed for {BY_HAND:g} s")
    return {}


def _check_hall_count(stand: PortStand) -> dict[str, float | str]:
    limits = stand.limits
    circumference = 2.0 * math.pi * limits.tyre_radius * LENGTH_UNIT
    expected = TURNS * circumference / (limits.pulse * TRAVEL_UNIT)
    start, still = stand.drive.hall_count, [stand.now(), stand.drive.hall_count]

    def rests_after_turning() -> bool:
        if stand.drive.hall_count != still[1]:
            still[:] = [stand.now(), stand.drive.hall_count]
        return stand.drive.hall_count != start and stand.now() - still[0] > 3.0

    _by_hand(
        stand,
        f"Turn the driven wheel forward by hand, exactly {TURNS} times, with its brake held open, "
        "then leave it for 3 s and close the brake.",
        rests_after_turning,
        "the wheel did not turn, or not come to rest",
    )
    counted = stand.drive.hall_count - start
    measured = f"{counted} pulses in {TURNS} turns, must be {expected:.0f} ± 5 %"
    _require(counted > 0, f"{measured}: the direction wire or two halls are exchanged")
    ratio = counted / expected
    if 0.45 < ratio < 0.55:
        raise CheckFailedError(
            f"{measured}: half of the edges are lost; three XORed halls give 3 edges, not 6"
        )
    _require(abs(ratio - 1.0) <= 0.05, f"{measured}: pulses or radius of the vehicle file")
    return {"pulses per turn": counted / TURNS, "expected per turn": expected / TURNS}


def _check_servo(stand: PortStand) -> dict[str, float | str]:
    _arm(stand)
    measured: dict[str, float | str] = {}
    end = 0.95 * stand.settings.max_steering_angle
    tracking = min(_TRACKING, 0.5 * end)  # or a wrong sign would pass
    for name, angle in (("centre", 0.0), ("left", end), ("right", -end), ("back", 0.0)):
        stand.command(angle, 0.0)
        stand.wait(3.0, lambda angle=angle: abs(_angle(stand) - angle) <= tracking / 5)  # type: ignore[misc]
        reached = measured[f"servo {name} (rad)"] = _angle(stand)
        _require(
            abs(reached - angle) <= tracking,
            f"servo {name}: {reached:+.3f} rad, must be {angle:+.3f} ± {tracking:.2g} rad "
            "(centre of the horn, sign of the potentiometer)",
        )
    return measured


def _check_motor(stand: PortStand) -> dict[str, float | str]:
    _arm(stand)
    measured: dict[str, float | str] = {}
    fast = _speed_on_rollers(stand)
    for name, speed in (("forward", fast), ("backward", -fast)):
        before = stand.drive.hall_count
        stand.command(0.0, speed)
        reached = stand.wait(4.0, lambda speed=speed: abs(_speed(stand) - speed) < 0.2 * fast)  # type: ignore[misc]
        _require_no_fault(stand)
        measured[f"{name} (m/s)"] = _speed(stand)
        counted = stand.drive.hall_count - before
        _require(
            reached and counted * speed > 0,
            f"{name}: {_speed(stand):+.2f} m/s with {counted:+d} pulses, must be {speed:+.2f} "
            "(direction of the motor, sign of the hall)",
        )
        _stop(stand)
    return measured


def _check_brake(stand: PortStand) -> dict[str, float | str]:
    _turn(stand)
    speed, start = _speed(stand), stand.drive.hall_count
    stand.disarm()
    _require(stand.wait(1.0, _both(stand, PlcState.SAFE)), "DISARM did not lead to SAFE")
    _rest(stand)
    rolled = abs(stand.drive.hall_count - start) * stand.limits.pulse * TRAVEL_UNIT
    longest = stopping_distance(Cause.DISARM, speed)
    _require(
        rolled <= longest,
        f"DISARM at {speed:.2f} m/s: the wheel rolled {rolled:.2f} m, must be {longest:.2f} m at "
        "most: the brake is weak, or is not closed",
    )
    before, until = stand.drive.hall_count, stand.now() + 5.0
    stand.say("Try to turn the driven wheel by hand for 5 s: the brake must hold it.")
    stand.wait(5.0, lambda: stand.now() >= until)
    slipped = abs(stand.drive.hall_count - before)
    _require(slipped <= 2, f"the wheel turned by {slipped} pulses against the brake")
    return {"rolled to rest (m)": rolled, "pulses against the brake": slipped}


def _check_watchdog(stand: PortStand) -> dict[str, float | str]:
    _turn(stand)
    allowed = INPUT_AGE + WATCHDOG + _REACTION  # the host repeats the last command so long
    silent_at = stand.now()
    stand.silence()
    tripped = stand.wait(1.0, lambda: bool(stand.drive.faults & Fault.CMD_TIMEOUT))
    after = stand.now() - silent_at
    _require(
        tripped and after <= allowed,
        f"without commands the drive PLC tripped after {after:.2f} s, must be {allowed:.2f} s",
    )
    return {"watchdog (s)": after, "at rest (s)": _rest(stand)}


def _check_host_stop(stand: PortStand) -> dict[str, float | str]:
    _turn(stand)
    at = stand.now()
    stand.emergency_stop()
    _require(stand.wait(0.5, _both(stand, PlcState.ESTOP)), "ESTOP did not stop both boards")
    reaction = stand.now() - at
    return {"reaction (s)": reaction, "at rest (s)": _rest(stand)}


def _check_cable(stand: PortStand) -> dict[str, float | str]:
    _turn(stand)
    _by_hand(
        stand,
        "Pull the drive board's USB cable.",
        lambda: not stand.connected(Board.DRIVE),
        "the link to the drive PLC stayed up",
    )
    _require(
        stand.wait(2.0, lambda: stand.steer.state != PlcState.ARMED),
        "the steer PLC stayed armed without the drive PLC",
    )
    stand.say("Does the wheel stand still? Put the cable back.")
    _require(
        stand.wait(BY_HAND, lambda: stand.connected(Board.DRIVE)),
        "the drive PLC did not come back",
    )
    _require(stand.wait(1.0, _both(stand, PlcState.SAFE)), "a board is not SAFE after the cable")
    _require(abs(_speed(stand)) < AT_REST, "the wheel still turns")
    return {}


STEPS = (
    Step("links, set-up and supply", _check_links),
    Step("emergency stop", _check_emergency_stop),
    Step("steering sensor", _check_steering_sensor),
    Step("hall sensor's lines", _check_hall_lines),
    Step("hall count", _check_hall_count),
    Step("servo centre and ends", _check_servo),
    Step("motor direction", _check_motor),
    Step("brake", _check_brake),
    Step("watchdog", _check_watchdog),
    Step("emergency stop by the host", _check_host_stop),
    Step("cable pulled", _check_cable),
)
"""The steps, in their order."""


def bring_up(stand: PortStand, steps: tuple[Step, ...] = STEPS) -> Iterator[StepResult]:
    """Run the steps in their order, up to the first that does not pass.

    Parameters
    ----------
    stand : PortStand
        Both boards and the engineer.
    steps : tuple of Step
        Steps to run.

    Yields
    ------
    result : StepResult
        Result of each step, as soon as it ends.
    """
    for step in steps:
        try:
            measured = step.run(stand)
        except LinkError as error:
            yield StepResult(step.name, False, {}, str(error))
            return
        yield StepResult(
            step.name, True, {k: v if isinstance(v, str) else float(v) for k, v in measured.items()}
        )


def _require_no_fault(stand: PortStand) -> None:
    for name, state in (("steer", stand.steer), ("drive", stand.drive)):
        if state.state in (PlcState.FAULT, PlcState.ESTOP):
            condition = f"{state_name(state.state)} ({fault_names(state.faults & ~Fault.LIMIT)})"
            hint = _LIGHT if state.faults & (Fault.PULSES | Fault.OVERSPEED) else ""
            raise CheckFailedError(f"the {name} PLC is {condition}{hint}")


def _arm(stand: PortStand) -> None:
    # where the steering stands, or within its limit where it stands at the end stop
    most = stand.settings.max_steering_angle
    stand.command(min(max(_angle(stand), -most), most), 0.0)
    reason = stand.arm()
    _require(reason is None, reason or "")


def _turn(stand: PortStand) -> None:
    """Arm and turn the driven wheel."""
    _arm(stand)
    speed = _speed_on_rollers(stand)
    stand.command(0.0, speed)
    reached = stand.wait(4.0, lambda: _speed(stand) > 0.8 * speed)
    _require_no_fault(stand)
    _require(reached, f"the wheel turns at {_speed(stand):.2f} m/s, must be {speed:g}")


def _stop(stand: PortStand) -> None:
    stand.command(0.0, 0.0)
    _rest(stand)


def _rest(stand: PortStand) -> float:
    """Wait for the wheel's rest and return how long it took [s]."""
    start = stand.now()
    _require(
        stand.wait(4.0, lambda: abs(_speed(stand)) < AT_REST),
        f"the wheel still turns at {_speed(stand):.2f} m/s after 4 s",
    )
    return stand.now() - start
