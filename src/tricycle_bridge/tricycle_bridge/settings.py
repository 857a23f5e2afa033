"""Settings of the bridge, each with its range and its description."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

from tricycle_bridge.protocol.limits import MAX_ACCELERATION, MAX_STEERING_RATE
from tricycle_bridge.protocol.messages import SPEED_UNIT, STEER_RATE_UNIT
from tricycle_core.errors import LinkError


def _setting(default: float, low: float, high: float, description: str) -> Any:
    return dataclasses.field(
        default=default, metadata={"range": (low, high), "description": description}
    )


@dataclass(frozen=True)
class BridgeSettings:
    """Rates, limits and the tyre of the vehicle; the node has a parameter of each name.

    The metadata of each field hold its ``range`` and its ``description``.

    Attributes
    ----------
    command_rate : float
        Rate at which a command is repeated between two messages of the commander [Hz].
    tyre_radius : float
        Radius of the rear wheel [m].
    max_steering_rate : float
        Largest rate of the steering motor's set-point [rad/s].
    max_acceleration : float
        Largest acceleration of the speed's set-point [m/s^2].

    Raises
    ------
    LinkError
        A value is outside its range.
    """

    command_rate: float = _setting(50.0, 20.0, 100.0, "Hz of repeats between messages")
    tyre_radius: float = _setting(0.335, 0.05, 2.0, "m, of the rear wheel")
    max_steering_rate: float = _setting(
        2.0, STEER_RATE_UNIT, MAX_STEERING_RATE, "rad/s, slew of the steering motor"
    )
    max_acceleration: float = _setting(
        1.0, SPEED_UNIT, MAX_ACCELERATION, "m/s^2, slew of the speed"
    )

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            low, high = field.metadata["range"]
            if not low <= value <= high:
                raise LinkError(f"{field.name} = {value:g} is outside {low:g}..{high:g}")
