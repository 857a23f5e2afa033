"""Our own vehicle, the model of `docs/model.md`, as a plant."""

from tricycle_core.poses import Pose
from tricycle_sim.vehicle import Vehicle
from tricycle_sim.vehicle.live import LiveState, LiveVehicle


class OwnPlant:
    """The vehicle of a vehicle file.

    Parameters
    ----------
    vehicle : Vehicle
        Vehicle with its true values.
    seed : int
        Not used: nothing is random.
    """

    def __init__(self, vehicle: Vehicle, seed: int = 0) -> None:  # noqa: ARG002 (of every plant)
        self._vehicle = vehicle
        self._live = LiveVehicle(vehicle)

    def place(self, start: Pose) -> LiveState:
        """Return the state at rest at a pose.

        Parameters
        ----------
        start : (float, float, float)
            x, y [m] and heading [rad].
        """
        self._live = LiveVehicle(self._vehicle, start=start)
        return self._live.state

    def advance(
        self,
        tick: int,  # noqa: ARG002 (of every plant)
        steering: float | None,
        torque: float,
        brake: float,
    ) -> LiveState:
        """Return the state after a tick.

        Parameters
        ----------
        tick, steering, torque, brake : int, float or None, float, float
            Arguments of `Plant.advance`.
        """
        return self._live.step(steering=steering, torque=torque, brake=brake)

    def hold_speed(
        self,
        tick: int,  # noqa: ARG002 (of every plant)
        steering: float | None,
        speed: float,
        brake: float,
    ) -> LiveState:
        """Return the state after a tick with a set-point of the speed.

        Parameters
        ----------
        tick, steering, speed, brake : int, float or None, float, float
            Arguments of `HoldsSpeed.hold_speed`.
        """
        return self._live.step(steering=steering, speed=speed, brake=brake)

    def close(self) -> None:
        """Do nothing."""
