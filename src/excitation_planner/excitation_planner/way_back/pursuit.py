"""Pursuit of a route at walking pace: closed loop, from arc to arc, at rest between them."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from excitation_planner.area.fence import START_HEADING_TOLERANCE, START_POSITION_TOLERANCE
from excitation_planner.way_back.dubins import Arc
from tricycle_bridge.commands.kinematics import TurningGeometry
from tricycle_core.errors import PlanError
from tricycle_core.poses import Pose, seen_from

WALKING_SPEED = 0.6
"""Largest speed [m/s]."""

CREEPING_SPEED = 0.12
"""Smallest commanded speed [m/s]."""

ACCELERATION = 0.3
"""Acceleration at the beginning of an arc [m/s^2]."""

DECELERATION = 0.2
"""Deceleration towards the end of an arc [m/s^2]."""

STEERING_RATE = 0.3
"""Rate of the motor while it turns the wheels at rest [rad/s]: a faster one shakes the vehicle."""

LAG = 0.15
"""Time for which the vehicle goes on after its command is standstill [s]."""

DECAY = 0.7
"""Way along which a deviation falls by a factor of e [m]."""

SMOOTHING = 0.2
"""Way along which the steering takes up a correction [m]; at rest it would not correct anything."""

SLACK = 1.4
"""Radius of the arcs over that of the tightest: the rest of the steering corrects deviations."""

SETTLING = 0.7
"""Time at rest before and after an arc [s]; poses are averaged over it."""

PROGRESS = 0.05
"""Way that shows that the vehicle moves [m] ..."""

BLOCKED = 5.0
"""... and the time without it after which something is in its way [s]."""

RESTLESS = 20.0
"""Time in which the vehicle must have come to rest with its wheels turned [s]."""

FARTHEST_OFF = 0.5
"""Deviation from the route beyond which it is given up [m]."""

ATTEMPTS = 4
"""Routes driven until the start counts as out of reach."""

SHARE = 0.6
"""Share of a start's tolerances within which the vehicle has arrived: the rest is for noise."""


@dataclass(frozen=True)
class Chassis:
    """Geometry of a vehicle for following a route; the driver has a parameter of each name.

    Attributes
    ----------
    geometry : TurningGeometry
        Angles of the steering motor, and how the vehicle turns with them.
    unsteered_axle : float
        Position of the unsteered axle's middle, ahead of `base_link` [m].
    tyre_radius : float
        Radius of the driven wheel's tyre [m].

    Raises
    ------
    PlanError
        If it does not steer to both sides.
    """

    geometry: TurningGeometry = field(default_factory=TurningGeometry)
    unsteered_axle: float = -0.719
    tyre_radius: float = 0.335

    def __post_init__(self) -> None:
        right, left = self.geometry.road_angles[0], self.geometry.road_angles[-1]
        if not right < 0.0 < left:
            raise PlanError(
                f"road_angles from {right:g} to {left:g} rad: must reach to both sides of 0"
            )

    @property
    def radius(self) -> float:
        """Radius of the arcs of a route [m]."""
        geometry = self.geometry
        reach = min(geometry.road_angles[-1], -geometry.road_angles[0])
        return SLACK * geometry.wheelbase / math.tan(reach)

    def axle(self, x: float, y: float, heading: float) -> Pose:
        """Return the pose of the middle of the unsteered axle for one of `base_link`.

        Parameters
        ----------
        x, y, heading : float
            Pose of `base_link` [m, m, rad].
        """
        a = self.unsteered_axle
        return x + a * math.cos(heading), y + a * math.sin(heading), heading

    def motor_angle(self, curvature: float) -> float:
        """Return the angle of the steering motor for a curvature of the axle's way [rad].

        Parameters
        ----------
        curvature : float
            Curvature of the axle's path, left positive [1/m].
        """
        return self.geometry.motor_angle(1.0, curvature)


@dataclass
class Pursuit:
    """Follows the arcs of one route; poses are those of the middle of the unsteered axle.

    Attributes
    ----------
    arcs : tuple of Arc
        Route; it begins where the vehicle stands.
    chassis : Chassis
        Steering geometry and tyre radius of the vehicle.
    angle : float
        Commanded steering motor angle [rad]; at first the present one.
    done : bool
        Whether the vehicle rests at the end of the last arc.
    curvature : float
        Commanded curvature [1/m], left positive.
    push : float
        Sign of the commanded drive: positive forwards, negative backwards, 0 none.
    """

    arcs: tuple[Arc, ...]
    chassis: Chassis
    angle: float = 0.0
    done: bool = False
    curvature: float = 0.0
    push: float = 0.0
    _index: int = -1
    _since: float = -math.inf  # of standstill with the wheels turned, or of the drive
    _stepped: float = -math.inf
    _along: float = 0.0  # way on the arc
    _reached: float = 0.0  # the farthest of it, but for less than `PROGRESS`
    _progressed: float = -math.inf  # when

    def step(self, pose: Pose, now: float, *, rests: bool) -> tuple[float, float]:
        """Return the commanded steering motor angle [rad] and speed [m/s].

        Parameters
        ----------
        pose : (float, float, float)
            Measured pose of the unsteered axle's middle [m, m, rad].
        now : float
            Present time [s].
        rests : bool
            Whether the vehicle stands still.

        Raises
        ------
        PlanError
            If the vehicle is too far off its route, or does not move though it is driven.
        """
        if self._index < 0:
            self._stepped = now
            self._begin(0, now)
        self._turn(now, rests)
        if self.push == 0.0:
            settled = now - self._since >= SETTLING
            self.done = settled and self._index == len(self.arcs)
            if self.done or not settled:
                return self.angle, 0.0
            self._since = self._progressed = now
        arc = self.arcs[self._index]
        sense = math.copysign(1.0, arc.length)
        before = self._along
        aside, turned = self._deviation(arc, sense, pose)
        if abs(aside) > FARTHEST_OFF:
            raise PlanError(f"{abs(aside):.2f} m off the way back (limit {FARTHEST_OFF:g} m)")
        if self._along > self._reached + PROGRESS:
            self._reached, self._progressed = self._along, now
        elif now - self._progressed > BLOCKED:
            raise PlanError(f"the vehicle is driven but has not moved for {BLOCKED:g} s")
        left = abs(arc.length) - self._along
        if left <= LAG * CREEPING_SPEED:
            self._begin(self._index + 1, now)
            return self.angle, 0.0
        speed = min(
            WALKING_SPEED,
            CREEPING_SPEED + ACCELERATION * (now - self._since),
            math.sqrt(2.0 * DECELERATION * left),
        )
        self.push = sense
        # critically damped along the way, forwards and backwards
        correction = -aside / DECAY**2 - 2.0 * sense * turned / DECAY
        share = min(max(self._along - before, 0.0) / SMOOTHING, 1.0)
        self.curvature += share * (arc.curvature + correction - self.curvature)
        self.angle = self.chassis.motor_angle(self.curvature)
        return self.angle, sense * max(speed, CREEPING_SPEED)

    def _begin(self, index: int, now: float) -> None:
        """Stand still before an arc."""
        self._index, self._since, self.push = index, now, 0.0
        self._along = self._reached = 0.0
        self.curvature = self.arcs[index].curvature if index < len(self.arcs) else 0.0

    def _turn(self, now: float, rests: bool) -> None:
        """Turn the wheels at rest to the arc ahead."""
        most, self._stepped = STEERING_RATE * (now - self._stepped), now
        if self.push == 0.0 and not rests:
            self._since = now
        elif self.push == 0.0:
            wanted = self.chassis.motor_angle(self.curvature)
            if abs(wanted - self.angle) > most:
                wanted, self._since = self.angle + math.copysign(most, wanted - self.angle), now
            self.angle = wanted

    def _deviation(self, arc: Arc, sense: float, pose: Pose) -> tuple[float, float]:
        """How far left of the arc [m] and turned to the left of it [rad]; the way on it goes on."""
        for _ in range(3):  # to the nearest point, from one close to it
            x, y, heading = arc.at(np.array(sense * self._along))
            ahead, aside = seen_from(np.array([pose[:2]]), x, y, heading)[0].tolist()
            self._along += sense * ahead / max(1.0 - arc.curvature * aside, 0.5)
        return aside, math.remainder(pose[2] - float(heading), math.tau)


@dataclass
class WayBack:
    """Leads a vehicle to a pose, route by route, until it has arrived.

    Attributes
    ----------
    goal : (float, float, float)
        Pose of `base_link` [m, m, rad].
    chassis : Chassis
        Steering geometry and tyre radius of the vehicle.
    angle : float
        Commanded steering motor angle [rad].
    wanted : Pose or None
        Pose of the unsteered axle's middle at rest while a route from there is needed, else None.
    arrived : bool
        Whether it rests at the goal.
    """

    goal: Pose
    chassis: Chassis
    angle: float = 0.0
    wanted: Pose | None = None
    arrived: bool = False
    pursuit: Pursuit | None = None
    _attempts: int = 0
    _since: float = -math.inf
    _still: float | None = None  # since when it is to stand still
    _poses: list[Pose] = field(default_factory=list)

    def follow(self, arcs: tuple[Arc, ...]) -> None:
        """Take the route that was wanted.

        Parameters
        ----------
        arcs : tuple of Arc
            Route from `wanted` to the goal.
        """
        self.wanted, self.pursuit = None, Pursuit(arcs, self.chassis, self.angle)

    def step(self, pose: Pose, now: float, *, rests: bool) -> tuple[float, float] | None:
        """Return steering motor angle [rad] and speed [m/s]; None: stand still with the last angle.

        Parameters
        ----------
        pose : (float, float, float)
            Measured pose of `base_link` [m, m, rad].
        now : float
            Present time [s].
        rests : bool
            Whether the vehicle stands still.

        Raises
        ------
        PlanError
            If it is off its route, has missed the goal too often, or does not come to rest.
        """
        driven = self.pursuit is not None and self.pursuit.push != 0.0
        if self._still is None or driven or self.wanted is not None:
            self._still = now
        elif now - self._still > RESTLESS:
            raise PlanError(
                f"the vehicle is to stand still, but odom has not said so for {RESTLESS:g} s: does "
                "it roll, or is the speed of the localisation too noisy? Drive it there by hand"
            )
        if self.pursuit is not None:
            command = self.pursuit.step(self.chassis.axle(*pose), now, rests=rests)
            self.angle = self.pursuit.angle
            if self.pursuit.done:
                self.pursuit = None
            return command
        if self.wanted is not None or self.arrived:
            return None
        if not rests or not self._poses:
            self._since, self._poses = now, []
        self._poses.append(pose)
        if now - self._since < SETTLING:
            return None
        poses, first = np.array(self._poses), self._poses[0][2]
        x, y = poses[:, :2].mean(axis=0).tolist()
        turns = [math.remainder(heading - first, math.tau) for heading in poses[:, 2]]
        heading = first + sum(turns) / len(turns)
        self._poses = []
        off = math.hypot(x - self.goal[0], y - self.goal[1])
        turned = abs(math.remainder(heading - self.goal[2], math.tau))
        if off <= SHARE * START_POSITION_TOLERANCE and turned <= SHARE * START_HEADING_TOLERANCE:
            self.arrived = True
        elif self._attempts == ATTEMPTS:
            raise PlanError(
                f"{off:.2f} m and {math.degrees(turned):.1f} deg off the start after {ATTEMPTS} "
                "routes; drive it there by hand"
            )
        else:
            self._attempts += 1
            self.wanted = self.chassis.axle(x, y, heading)
        return None
