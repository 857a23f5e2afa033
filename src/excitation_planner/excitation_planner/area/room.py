"""Whether a maneuver fits an area: its tube, the best start pose, and what is lacking."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import shapely

from excitation_planner.area.area import Area
from excitation_planner.area.fence import START_POSITION_TOLERANCE
from excitation_planner.area.placement import Placement, at_pose, best_placement, clearance_of
from excitation_planner.area.tube import BEYOND, TOLERANCE, Tube, tube_of
from tricycle_core.errors import InfeasibleManeuver, PlanError
from tricycle_core.quantities import FloatArray
from tricycle_sim.commands import Commands
from tricycle_sim.vehicle import Vehicle

DIRECTION_NOISE = 0.05
"""Distance by which a slow vehicle's noisy direction moves the stop that the fence expects [m]."""


ALLOWANCE = 0.3
"""Room to spare at which a rough placement ends: vehicles that it leaves out need some [m]."""


class DoesNotFit(InfeasibleManeuver):
    """A maneuver does not fit the area."""


@dataclass(frozen=True)
class Fit:
    """A maneuver on its area.

    Attributes
    ----------
    placement : Placement
        Start pose with the largest clearance.
    drive, whole : shapely.Polygon
        The parts `drive` and `whole` of the maneuver's `Tube`, in the area's frame.
    needed : float
        Clearance that is required [m].
    """

    placement: Placement
    drive: shapely.Polygon
    whole: shapely.Polygon
    needed: float

    @property
    def shortage(self) -> float:
        """Clearance that is lacking [m]; negative: clearance to spare."""
        return self.needed - self.placement.clearance


@dataclass(frozen=True)
class Room:
    """Area with the vehicle's footprint and position noise: what a maneuver must fit.

    Attributes
    ----------
    area : Area
        Ground, with its margin and start poses.
    footprint : ndarray of float, shape (m, 2)
        Corners of the vehicle in its body frame [m].
    position_std : float
        Standard deviation of the localisation [m]; three of it are kept beside the margin.
    kept_load : float
        Least load of every wheel of the vehicles of the ranges, as in `tube_of`.

    Raises
    ------
    PlanError
        If the vehicle itself does not fit the area.
    """

    area: Area
    footprint: FloatArray
    position_std: float = 0.0
    kept_load: float = 0.0

    def __post_init__(self) -> None:
        vehicle = np.ptp(self.footprint, axis=0)
        if min(self.area.extent) < vehicle.min():  # whatever its heading
            (along_x, along_y), (length, width) = self.area.extent, vehicle
            raise PlanError(
                f"keep_in: is {along_x:g} m x {along_y:g} m large, too small for the vehicle, "
                f"{length:.2f} m x {width:.2f} m; its corners are in m"
            )

    @property
    def needed(self) -> float:
        """Required distance between a tube and the border [m]."""
        return (
            self.area.margin + 3.0 * self.position_std + START_POSITION_TOLERANCE + DIRECTION_NOISE
        )

    def _tube(self, vehicle: Vehicle, commands: Commands, *, rough: bool = False) -> Tube:
        return tube_of(vehicle, commands, self.footprint, rough=rough, kept_load=self.kept_load)

    def fit(self, vehicle: Vehicle, commands: Commands) -> Fit:
        """Return how a maneuver fits, at its best start pose.

        Parameters
        ----------
        vehicle : Vehicle
            Vehicle with the ranges of its unknown parameters.
        commands : Commands
            Commands of the maneuver.

        Raises
        ------
        InfeasibleManeuver
            If a vehicle of the ranges rolls over, or keeps less than `kept_load`.
        """
        tube = self._tube(vehicle, commands)
        best = best_placement(tube.whole, self.area)
        if best.clearance < self.needed:
            # the searches of `lacks` sometimes find a pose that this one has missed
            place = self.roughly_placed(vehicle, commands)
            there = at_pose(tube.whole, place.x, place.y, place.heading)
            other = replace(place, clearance=clearance_of(np.array([there]), self.area))
            enough = best_placement(tube.whole, self.area, enough=self.needed)
            best = max(best, other, enough, key=lambda placement: placement.clearance)
        x, y, heading = best.x, best.y, best.heading
        return Fit(
            best,
            at_pose(tube.drive, x, y, heading),
            at_pose(tube.whole, x, y, heading),
            self.needed,
        )

    def roughly_placed(self, vehicle: Vehicle, commands: Commands) -> Placement:
        """Return the best start pose for a rough tube, which needs no more room than the whole.

        Parameters
        ----------
        vehicle : Vehicle
            Vehicle with the ranges of its unknown parameters.
        commands : Commands
            Commands of the maneuver.

        Raises
        ------
        InfeasibleManeuver
            If one of a few vehicles of the ranges rolls over, or keeps less than `kept_load`.
        """
        rough = self._tube(vehicle, commands, rough=True)
        return best_placement(rough.whole, self.area, enough=self.needed + ALLOWANCE)

    def lacks(self, vehicle: Vehicle, commands: Commands, place: Placement) -> float:
        """Return by how much the border is too close [m]; 0 or less as soon as it is known to fit.

        Parameters
        ----------
        vehicle : Vehicle
            Vehicle with the ranges of its unknown parameters.
        commands : Commands
            Commands of the maneuver.
        place : Placement
            Start pose that is tried first, from `roughly_placed`.

        Raises
        ------
        InfeasibleManeuver
            If a vehicle of the ranges rolls over, or keeps less than `kept_load`.
        """
        tube = self._tube(vehicle, commands)
        there = at_pose(tube.pieces, place.x, place.y, place.heading)
        # the outline of all pieces is drawn up to twice the tolerance outwards
        shortage = self.needed + 2.0 * TOLERANCE - clearance_of(there, self.area)
        if shortage <= 0.0:
            return shortage
        return self.needed - best_placement(tube.whole, self.area, enough=self.needed).clearance

    def check(self, vehicle: Vehicle, commands: Commands) -> None:
        """Refuse a maneuver that does not fit.

        Parameters
        ----------
        vehicle : Vehicle
            Vehicle with the ranges of its unknown parameters.
        commands : Commands
            Commands of the maneuver.

        Raises
        ------
        DoesNotFit
            If the clearance is too small; `fit` returns by how much.
        InfeasibleManeuver
            If a vehicle of the ranges rolls over, or keeps less than `kept_load`.
        """
        place = self.roughly_placed(vehicle, commands)
        roughly = place.clearance >= self.needed - BEYOND
        if not roughly or self.lacks(vehicle, commands, place) > 0.0:
            raise DoesNotFit("does not fit the area")
