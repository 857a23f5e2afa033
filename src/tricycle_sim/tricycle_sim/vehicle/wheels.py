"""The wheels of a vehicle: where each is listed, what it does, how a file spells its constants."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from tricycle_core.errors import VehicleError

AXLES = ("front", "rear")
MOST_WHEELS = 4


@dataclass(frozen=True)
class Wheel:
    """A wheel, by the role it has.

    Attributes
    ----------
    name : str
        Name in logs, columns and constants: `front_left`.
    axle : str
        Axle: `front` or `rear`.
    steered, driven, braked : bool
        Whether steering, motor and brake act on it.
    """

    name: str
    axle: str
    steered: bool = False
    driven: bool = False
    braked: bool = False

    def spellings(self, constant: str) -> tuple[tuple[str, float], ...]:
        """Return the entries of a vehicle file that may hold a constant of this wheel.

        Parameters
        ----------
        constant : str
            `x`, `y` or another constant of a wheel.

        Returns
        -------
        tuple of (str, float)
            Entry and the factor of its value, the first one counts.
        """
        own = ((f"{self.name}.{constant}", 1.0), (f"{self.axle}.{constant}", 1.0))
        match constant:
            case "x":
                sign = 1.0 if self.axle == "front" else -1.0
                return (*own, (f"com_to_{self.axle}_axle", sign))
            case "y":
                return (*own, (f"{self.name}_wheel_y", 1.0))
            case "wheel_inertia":
                return (*own, (f"{self.axle}_wheel_inertia", 1.0), (constant, 1.0))
        return (*own, (constant, 1.0))


TADPOLE = (
    Wheel("left", "front", steered=True),
    Wheel("right", "front", steered=True),
    Wheel("rear", "rear", driven=True, braked=True),
)
"""Wheels of the paper's tricycle, and of every file that lists no wheels."""


def check_wheels(wheels: Sequence[Wheel]) -> None:
    """Raise a `VehicleError` unless the model can simulate a vehicle with these wheels.

    Parameters
    ----------
    wheels : sequence of Wheel
        Wheels of a vehicle, in its order.
    """
    for problem in _problems(wheels):
        raise VehicleError(f"wheels: {problem}")


def _problems(wheels: Sequence[Wheel]) -> Iterator[str]:
    names = [wheel.name for wheel in wheels]
    if not 3 <= len(wheels) <= MOST_WHEELS:
        yield f"needs three or four, not {len(wheels)}"
    for wheel in wheels:
        if not wheel.name.isidentifier():
            yield f"{wheel.name!r} is no name: needs letters, digits and _"
        if names.count(wheel.name) > 1:
            yield f"two are called {wheel.name}"
        if wheel.axle not in AXLES:
            yield f"{wheel.name}.axle: needs front or rear, not {wheel.axle!r}"
        if wheel.name in AXLES and sum(wheel.axle == other.axle for other in wheels) > 1:
            yield f"{wheel.name}: is the name of an axle with another wheel"
        if wheel.name in AXLES and wheel.name != wheel.axle:
            yield f"{wheel.name}: is the name of the other axle"
    for axle in AXLES:
        if not 1 <= [wheel.axle for wheel in wheels].count(axle) <= 2:
            yield f"the {axle} axle needs one or two"
    for what in ("steered", "driven"):
        if not any(getattr(wheel, what) for wheel in wheels):
            yield f"at least one has to be {what}"
    steered = {wheel.axle for wheel in wheels if wheel.steered}
    if len(steered) > 1 or any(w.axle in steered and not w.steered for w in wheels):
        yield "the steered ones have to be all of one axle"
    driven = {wheel.axle for wheel in wheels if wheel.driven}
    if any(w.axle in driven and not w.driven for w in wheels):
        yield "both of an axle are driven, or none"
