"""Limits reached in a simulated drive: wheel loads, friction, saturations, roll-over."""

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tricycle_core.quantities import FloatArray
from tricycle_core.timing import TICK
from tricycle_sim.vehicle.layout import EVENT, EVENT_ROWS, LANES
from tricycle_sim.vehicle.wheels import Wheel

SATURATED = "steering saturated"
"""Words for a saturation of the steering of which nothing more is known."""


@dataclass(frozen=True)
class Event:
    """Something that happened to each sample of a run, with its time and place.

    All of shape (n,). Where it did not happen, time and place are NaN.
    """

    value: FloatArray
    time: FloatArray  # s from the start
    x: FloatArray  # m, COM in the world
    y: FloatArray  # m

    @property
    def happened(self) -> NDArray[np.bool_]:
        """Whether it happened, for each sample, shape (n,)."""
        return np.isfinite(self.time)


@dataclass(frozen=True)
class Feasibility:
    """Limits that each of n vehicles reached in a drive, with time and place."""

    # smallest load by wheel [N]; 0: the wheel lifted, then time and place of that
    least_load: Mapping[str, Event]
    friction: Event  # largest force of a tyre over its friction limit: at most 1 where it slides
    # first time the set-point fell behind the commands, or was beyond the end stop [rad]
    steering_saturated: Event
    motor_saturated: Event  # first time the motor could not give the torque, what was missing [N m]
    rolled_over: Event  # the vehicle is at rest where it is from then on
    saturation: str = SATURATED  # what `steering_saturated` is, in words

    @property
    def wheel_lifted(self) -> NDArray[np.bool_]:
        """Whether a wheel lifted, for each sample, shape (n,)."""
        lifted: NDArray[np.bool_] = np.any(
            [event.value <= 0.0 for event in self.least_load.values()], axis=0
        )
        return lifted

    @property
    def feasible(self) -> NDArray[np.bool_]:
        """Whether steering was not saturated, no wheel lifted, and none rolled over, shape (n,)."""
        bad = self.wheel_lifted | self.steering_saturated.happened | self.rolled_over.happened
        return ~bad

    def reasons(self, sample: int) -> tuple[str, ...]:
        """Return why a sample is infeasible, a line each with time and place."""
        reasons = [
            (self.saturation, self.steering_saturated),
            *(
                (f"{name} wheel lifted", _where_lifted(event))
                for name, event in self.least_load.items()
            ),
            ("rolled over", self.rolled_over),
        ]
        return tuple(
            f"{what} at {event.time[sample]:.2f} s, "
            f"x = {event.x[sample]:.2f} m, y = {event.y[sample]:.2f} m"
            for what, event in reasons
            if event.happened[sample]
        )


def read_feasibility(
    groups: FloatArray, n: int, wheels: Sequence[Wheel], saturation: str = SATURATED
) -> Feasibility:
    """Return the limits that vehicles reached, as recorded in their groups.

    Parameters
    ----------
    groups : ndarray of float, shape (b, ROWS * LANES)
        Groups of the vehicles, after `advance`.
    n : int
        Number of samples.
    wheels : sequence of Wheel
        Wheels of the vehicle, in its order.
    saturation : str
        What a saturation of the steering is, in words.
    """
    rows = groups.reshape(len(groups), -1, LANES)

    def event(row: int) -> Event:
        value, tick, x, y = (
            rows[:, row : row + EVENT_ROWS].transpose(1, 0, 2).reshape(EVENT_ROWS, -1)[:, :n]
        )
        # only the least loads start above 0, at infinity, and they always happen
        never = value == 0.0 if row < EVENT.least_load else np.zeros(n, dtype=bool)
        time, x, y = (np.where(never, np.nan, item) for item in (tick * TICK, x, y))
        return Event(value.copy(), time, x, y)

    friction = event(EVENT.friction_squared)
    return Feasibility(
        least_load={
            wheel.name: event(EVENT.least_load + EVENT_ROWS * index)
            for index, wheel in enumerate(wheels)
        },
        friction=dataclasses.replace(friction, value=np.sqrt(friction.value)),
        steering_saturated=event(EVENT.steering),
        motor_saturated=event(EVENT.motor),
        rolled_over=event(EVENT.rollover),
        saturation=saturation,
    )


def _where_lifted(load: Event) -> Event:
    never = load.value > 0.0
    return dataclasses.replace(load, time=np.where(never, np.nan, load.time))
