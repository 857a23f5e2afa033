"""Playback of a maneuver's commands, open loop, and the way back to its start, closed loop.

This is the state machine of the driver, without ROS.

Time is an argument everywhere; the node that owns a `Playback` passes its ROS clock.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from excitation_planner.area.fence import (
    START_HEADING_TOLERANCE,
    START_POSITION_TOLERANCE,
    Fence,
)
from excitation_planner.line_keeping import LineKeeping
from excitation_planner.localisation import (
    WINDOW,
    PlanarState,
    PoseWatch,
    ProgressWatch,
    RestingPoses,
)
from excitation_planner.plan_parts import PlanParts
from excitation_planner.preflight import Check
from excitation_planner.schedule import Schedule
from excitation_planner.vehicle_watch import CLOCK_TOLERANCE, VehicleWatch
from excitation_planner.way_back.dubins import Arc
from excitation_planner.way_back.pursuit import Chassis, WayBack
from excitation_planner.way_back.route import RouteRequest
from tricycle_core.diagnostics import Level
from tricycle_core.errors import PlanError
from tricycle_core.maneuver_state import PlaybackState
from tricycle_core.poses import Pose, seen_from
from tricycle_core.quantities import FloatArray
from tricycle_core.readiness import Readiness

STALL = 0.1
"""Time without a command [s] after which a run is not the planned one; the boards hold the last."""

PREPARATION = 0.5
"""Time before row 0 for which standstill with its steering angle is commanded [s].

The wheels turn to where the maneuver starts, and the bridge has changed over to these commands. It
is longer, by up to `ARRIVAL`, until the wheels are there and the vehicle, which they push, rests.
"""

ARRIVAL = 10.0
"""Time after `PREPARATION` for which wheels and the vehicle's rest are waited for, at most [s]."""

BEING_STOPPED = "the vehicle is being stopped after a run; try again when it rests"
"""Why a start is refused that comes too soon."""

SHORTEST_STOP, LONGEST_STOP = 2.0, 5.0
"""Times after the end of a run for which standstill is commanded [s]: in between, until rest.

The shortest leaves an operator the time to record the standstill and to disarm.
"""

NEAR = 1000
"""Points of the path, either way of the nearest one, among which it is looked for first."""

DRIVEN = PlaybackState.RUNNING, PlaybackState.RETURNING
"""States in which the wheels turn as commanded."""


@dataclass(frozen=True)
class JointCommand:
    """Command for the two joints.

    Attributes
    ----------
    steering_motor_angle : float
        Steering motor angle, left positive [rad].
    wheel_rate : float
        Rate of the rear wheel, forward positive [rad/s].
    stop : bool
        Whether the boards are to stop the vehicle instead, motor and brake, until it is armed
        again. At a wheel rate of 0 the motor alone slows it down, which on a slope takes longer
        than the fence counts on.
    """

    steering_motor_angle: float
    wheel_rate: float
    stop: bool = False


@dataclass(frozen=True)
class _Plan:
    schedule: Schedule
    stamp: int  # ns, of its message
    plan_id: str


def _failures(checks: Sequence[Check]) -> list[str]:
    return [f"{check.name}: {check.message}" for check in checks if check.level is Level.ERROR]


@dataclass
class Playback:
    """Plays schedules, one after the other.

    A maneuver runs only while the vehicle says that it is armed, and its pose is known and near the
    path.

    Attributes
    ----------
    watch : VehicleWatch
        Newest messages of the vehicle; the run is aborted if one speaks against it.
    max_deviation : float
        Distance from the path beyond which the run is aborted [m].
    countdown : float
        Time between the start and the first command [s].
    ground_needed : bool
        Whether a plan must state its ground, even if only that it has none; a plan whose ground has
        not come yet is then not driven without its fence.
    chassis : Chassis
        Geometry with which the vehicle is led back to a start.
    parts : PlanParts
        Messages that accompany the plans' commands.
    state : PlaybackState
        Present activity of the driver.
    reason : str
        Why the run ended before its last command; empty otherwise.
    start_time : float or None
        Time at which row 0 was played [s].
    elapsed : float
        Time since `start_time`, or since the request to go back, at the newest tick [s].
    seconds_left : int
        Rest of the countdown [s].
    """

    watch: VehicleWatch
    max_deviation: float
    countdown: float = 0.0
    ground_needed: bool = False
    chassis: Chassis = field(default_factory=Chassis)
    parts: PlanParts = field(default_factory=PlanParts)
    state: PlaybackState = PlaybackState.WAITING
    reason: str = ""
    start_time: float | None = None
    elapsed: float = 0.0
    seconds_left: int = 0
    _plan: _Plan | None = None
    _next: _Plan | None = None  # came during the run
    _finishing: str = ""  # why the maneuver is to end at the next tick
    _line_keeping: LineKeeping | None = None  # of the maneuver running
    _fence: Fence | None = None  # of the maneuver running
    _resting: RestingPoses = field(default_factory=RestingPoses)  # before row 0
    _poses: PoseWatch = field(default_factory=PoseWatch)
    _progress: ProgressWatch = field(default_factory=ProgressWatch)  # of the maneuver running
    _way: float = 0.0  # that it has commanded, m
    _contradiction: str = ""
    _path: FloatArray = field(default_factory=lambda: np.empty((0, 2)))  # of the maneuver running
    _nearest: int = 0  # point of it
    _asked_at: float = -math.inf  # when it was started
    _anchor: PlanarState | None = None
    _stood: Pose | None = None  # mean pose of the first `WINDOW` of the countdown
    _back: WayBack | None = None  # while the vehicle returns
    _last_start: Pose | None = None  # where the newest maneuver began
    _lost_start: str = ""  # how the poses have jumped since
    _held: JointCommand = field(default_factory=lambda: JointCommand(0.0, 0.0))
    _ticked_at: float = -math.inf
    _stopping_since: float | None = None  # None: not since a run has ended

    def load(self, schedule: Schedule, stamp: int = 0, plan_id: str = "") -> None:
        """Take a new schedule; during a run it is kept for the time after.

        Parameters
        ----------
        schedule : Schedule
            Schedule to be played next.
        stamp : int
            Stamp of its message [ns].
        plan_id : str
            Identifier of its plan.
        """
        self._next = _Plan(schedule, stamp, plan_id)
        if not self._active and self._stopping_since is None:
            self._take_next()

    def observe(self, state: PlanarState, stamp: float, now: float) -> None:
        """Take the newest pose and speed.

        Parameters
        ----------
        state : PlanarState
            Pose and speed of the vehicle.
        stamp : float
            Time of the measurement, by the clock of its sender [s].
        now : float
            Time of receipt [s].
        """
        self.watch.observe(state, stamp, now)
        if not state.finite or state.implausible:
            return  # `pose_lost` says so
        driven = self.state in DRIVEN and self._held.wheel_rate != 0.0
        contradiction = self._poses.contradiction(state, stamp, driven=driven)
        if contradiction and not self._poses.frozen:
            self._lost_start = contradiction  # its frame may have another origin now
        if self.state not in DRIVEN:
            self._resting.take(state, stamp)
        if not self._active:
            self._contradiction = contradiction
        elif not self._contradiction:
            watched = self._steered_by_pose or self._fence is not None
            # a pose that stays the same is near the path for ever
            self._contradiction = contradiction if watched else self._poses.frozen
        if self.state is PlaybackState.RUNNING and not self._contradiction:
            self._contradiction = self._progress.stands(state, self._way, now)

    def hear(self, readiness: Readiness, now: float) -> None:
        """Take what the vehicle says about itself; a run is aborted at once if it does not obey.

        Parameters
        ----------
        readiness : Readiness
            Content of the newest message of `vehicle/state`.
        now : float
            Time of receipt [s].
        """
        self.watch.hear(readiness, now)
        if not readiness.armed:
            self._held = replace(self._held, stop=False)
        if self._active and (not readiness.armed or readiness.refused):
            self.abort(self.watch.not_ready(now))

    def hold(self, pressed: bool, now: float) -> None:
        """Take whether the hold-to-run button is pressed; a run is aborted at once if it is not.

        A vehicle that rolls out after a run is stopped by the boards then, at the next tick.

        Parameters
        ----------
        pressed : bool
            Newest word of it.
        now : float
            Time of receipt [s].
        """
        self.watch.hold(pressed, now)
        if self._active and (reason := self.watch.released(now)):
            self.abort(reason)

    def preflight(self, now: float) -> tuple[Check, ...]:
        """Look at everything that a start needs.

        Parameters
        ----------
        now : float
            Present time [s].

        Returns
        -------
        tuple of Check
            Plan, vehicle, hold-to-run button, localisation, standstill, ground, start pose.
        """
        plan = self._plan
        name = f"{plan.plan_id}, {plan.schedule.duration:.1f} s" if plan else ""
        localisation = Check.of("localisation", self._unwatched(now), "")
        if localisation.level is Level.OK:
            localisation = self._resting.check(now - self.watch.stamp)
        return (
            Check.of("plan", self._plan_missing(), name),
            Check.of("vehicle", self._disobeys(now), "armed"),
            Check.of(
                "hold to run",
                self.watch.released(now),
                "pressed" if self.watch.hold_timeout else "no button has to be held",
            ),
            localisation,
            Check.of("standstill", self.watch.moves(), f"{self.watch.speed:.2f} m/s"),
            *self._check_ground(now),
        )

    def start(self, now: float, others: Sequence[Check] = ()) -> None:
        """Start the maneuver; row 0 is played after the countdown and `PREPARATION`, at rest.

        Parameters
        ----------
        now : float
            Present time [s].
        others : sequence of Check
            Items of the pre-flight that the playback does not check itself.

        Raises
        ------
        PlanError
            If it cannot start: the first check of the pre-flight that fails.
        """
        self._check_free()
        own = [c.message for c in self.preflight(now) if c.level is Level.ERROR]
        if failures := own + _failures(others):
            raise PlanError(failures[0])
        plan = self._plan
        path = None if plan is None else self.parts.path(plan.stamp)
        if plan is None or path is None:  # the pre-flight says so already
            raise PlanError("no plan is loaded")
        self._fence = self._fence_of(plan)
        self._poses, self._contradiction = PoseWatch(), ""
        self._progress, self._way = ProgressWatch(), 0.0
        self._path, self._nearest = path, 0
        self._line_keeping = self._line_keeping_of(plan)
        self._anchor = self.watch.observed
        self._resting, self._stood = RestingPoses(), None  # it may just have come to rest
        if self._anchor is not None:
            self._last_start = self._anchor.x, self._anchor.y, self._anchor.yaw
            self._lost_start = ""
        self._asked_at = now
        self.seconds_left = math.ceil(self.countdown)
        self.start_time, self.elapsed, self._finishing = None, 0.0, ""
        self.state, self.reason = PlaybackState.STARTING, ""

    def go_back(self, now: float, others: Sequence[Check] = ()) -> None:
        """Drive back, closed loop: to the planned start; without an area to the last run's start.

        Parameters
        ----------
        now : float
            Present time [s].
        others : sequence of Check
            Items of the pre-flight that the playback does not check itself.

        Raises
        ------
        PlanError
            If the vehicle cannot go back; the message is the reason.
        """
        self._check_free()
        self._check_standing(now)
        if reason := self.watch.undirected():
            raise PlanError(reason)
        if failures := _failures(others):
            raise PlanError(failures[0])
        fence = self._fence_of(self._plan) if self._plan is not None else None
        goal = self._last_start if fence is None else fence.start
        if goal is None:
            raise PlanError("no start to go back to: no plan with an area, and nothing driven yet")
        if fence is None and self._lost_start:
            raise PlanError(
                f"no start to go back to: the localisation has jumped since ({self._lost_start}); "
                "drive it there by hand"
            )
        if fence is not None and (reason := self._trespass(fence, now, 0.0, 0.0)):
            raise PlanError(f"{reason}; drive it back by hand")
        self._fence, self._poses, self._contradiction = fence, PoseWatch(), ""
        self._back = WayBack(goal, self.chassis, self._held.steering_motor_angle)
        self._anchor, self._held = None, JointCommand(self._held.steering_motor_angle, 0.0)
        self._asked_at = now
        self.start_time, self.elapsed = None, 0.0
        self.state, self.reason = PlaybackState.RETURNING, ""

    @property
    def route_wanted(self) -> RouteRequest | None:
        """Request for a route back; None while none is needed."""
        back, fence = self._back, self._fence
        if back is None or back.wanted is None:
            return None
        goal, radius = self.chassis.axle(*back.goal), self.chassis.radius
        if fence is None:
            return RouteRequest(back.wanted, goal, radius)
        footprint = fence.footprint - np.array([self.chassis.unsteered_axle, 0.0])
        return RouteRequest(back.wanted, goal, radius, fence.ground, footprint)

    def follow(self, route: tuple[Arc, ...]) -> None:
        """Take the requested route; ignored if it is no longer needed.

        Parameters
        ----------
        route : tuple of Arc
            Arcs of a route for the newest `route_wanted`.
        """
        if self._back is not None and self._back.wanted is not None:
            self._back.follow(route)

    def abort(self, reason: str) -> None:
        """Stop a running maneuver or the way back, by the boards once the wheels were to turn.

        A vehicle that rolls out after a maneuver that is done is stopped by the boards too; the
        maneuver stays done.

        Parameters
        ----------
        reason : str
            Why a run is aborted.

        Raises
        ------
        PlanError
            If none is running, and the vehicle does not roll out.
        """
        if self._rolls_out(self._ticked_at):
            self._held = replace(self._held, stop=True)
            return
        if not self._active:
            raise PlanError("no maneuver is running")
        self._end(PlaybackState.ABORTED, self._held.steering_motor_angle, reason)

    def finish(self, reason: str) -> None:
        """End the running maneuver well before its last command; standstill is commanded.

        Parameters
        ----------
        reason : str
            Why what is left of it is not needed.

        Raises
        ------
        PlanError
            If none is running.
        """
        if self.state is not PlaybackState.RUNNING:
            raise PlanError("no maneuver is running")
        self._finishing = reason

    def tick(self, now: float, held_up: float = 0.0) -> JointCommand | None:
        """Return the command for now.

        After a run it is standstill until the vehicle rests, after an aborted one first a stop
        until the vehicle is not armed; then, and before a run, None: nothing is commanded.

        Parameters
        ----------
        now : float
            Present time [s].
        held_up : float
            Time since the last tick by a clock that cannot be set, unlike that of `now` [s].
        """
        back = self._ticked_at - now
        if self.state is PlaybackState.RUNNING and back < 0.0:
            self._way -= back * self._held.wheel_rate * self.chassis.tyre_radius
        self._ticked_at = now
        if back > CLOCK_TOLERANCE:
            self.watch.forget()
            self._poses, self._contradiction = PoseWatch(), ""
            if self._stopping_since is not None:
                self._stopping_since = now
            if self._active:
                self.abort(f"the clock jumped back by {back:.2f} s")
        elif (late := max(-back, held_up)) > STALL and self.state is PlaybackState.RUNNING:
            self.abort(
                f"for {late:.2f} s no command was sent: a busy computer, or a clock that was set"
            )
        if self._back is not None:
            return self._return(self._back, now)
        if self._active and self._plan is not None:
            return self._play(self._plan.schedule, now)
        if self._stopping_since is None:
            return None
        stopping = now - self._stopping_since
        if stopping < SHORTEST_STOP or (stopping < LONGEST_STOP and not self.watch.rests(now)):
            if self._rolls_out(now) and (self.watch.released(now) or self._leaves(now)):
                self._held = replace(self._held, stop=True)
            return self._held
        self._stopping_since = None
        self._take_next()
        return None

    @property
    def fenced(self) -> bool:
        """Whether the maneuver that was started last has an area that it is kept in."""
        return self._fence is not None

    @property
    def duration(self) -> float:
        """Length of the loaded maneuver in s; 0 without one."""
        return self._plan.schedule.duration if self._plan else 0.0

    @property
    def plan_id(self) -> str:
        """Id of the plan that is loaded; empty without one."""
        return self._plan.plan_id if self._plan else ""

    @property
    def origin(self) -> PlanarState | None:
        """Pose to which the path is relative: of the start, before it the newest; None unknown."""
        origin = self._anchor or self.watch.observed
        return origin if origin is not None and origin.finite else None

    @property
    def anchored(self) -> bool:
        """Whether the origin is that of a start, and stays."""
        return self._anchor is not None

    @property
    def _active(self) -> bool:
        return self.state.driving

    @property
    def _steered_by_pose(self) -> bool:
        """Whether the vehicle is steered closed loop: in a lead-in or on the way back."""
        return self._line_keeping is not None or self._back is not None

    def _check_free(self) -> None:
        if self._active:
            raise PlanError("already running: wait for its end, or abort it (~/abort)")
        if self._stopping_since is not None:
            raise PlanError(BEING_STOPPED)

    def _plan_missing(self) -> str:
        if self._plan is None:
            return "no commands yet; publish a plan on maneuver/commands"
        if self.parts.path(self._plan.stamp) is None:
            return (
                "no path on maneuver/path with the stamp of the commands, to limit the deviation "
                "by; publish both with one stamp"
            )
        return ""

    def _check_ground(self, now: float) -> tuple[Check, ...]:
        """Whether the vehicle stands at the start of its plan, on its ground."""
        plan, here = self._plan, self.watch.observed
        if plan is None or here is None:
            return ()
        try:
            fence = self._fence_of(plan)
        except PlanError as error:
            return (Check("ground", str(error), Level.ERROR),)
        if fence is None:
            limit = f"no area: only max_deviation, {self.max_deviation:g} m, limits the drive"
            return (Check("ground", limit, Level.WARN),)
        if self.watch.pose_lost(now):  # the localisation's check says why
            return ()
        rates = plan.schedule.wheel_rate
        push = float(rates[np.flatnonzero(rates)[:1]].sum())
        outside = self._trespass(fence, now, float(fence.curvature[0]), push)
        return (
            Check.of("ground", outside, f"fenced in {fence.frame}"),
            Check.of("start", fence.off_start(here), "at the planned start"),
        )

    def _check_standing(self, now: float) -> None:
        """Refuse unless the vehicle obeys and stands where it can be watched."""
        if reason := (
            self._disobeys(now)
            or self.watch.released(now)
            or self._unwatched(now)
            or self.watch.moves()
        ):
            raise PlanError(reason)

    def _return(self, back: WayBack, now: float) -> JointCommand:
        pursuit, here, self.elapsed = back.pursuit, self.watch.observed, now - self._asked_at
        reason = self._unfit(now, directed=True)
        if not reason and self._fence is not None:
            curvature, push = (pursuit.curvature, pursuit.push) if pursuit else (0.0, 0.0)
            reason = self._trespass(self._fence, now, curvature, push)
        command = None
        if not reason and here is not None:
            try:
                pose = here.after(now - self.watch.stamp)
                command = back.step(pose, now, rests=self.watch.rests(now))
            except PlanError as error:
                reason = str(error)
        if reason:
            self.abort(reason)
        elif back.arrived:
            self._end(PlaybackState.WAITING, self._held.steering_motor_angle)
        elif command is not None:
            angle, speed = command
            self._held = JointCommand(angle, speed / self.chassis.tyre_radius)
        return self._held

    def _play(self, schedule: Schedule, now: float) -> JointCommand | None:
        row = 0 if self.start_time is None else self._row(schedule, now - self.start_time)
        if reason := (
            self._unfit(now, directed=self._steered_by_pose)
            or self._astray()
            or self._fenced_out(schedule, now, row)
        ):
            self.abort(reason)
            return self._held
        if self.start_time is None:
            self._prepare(schedule, now)
        if self.start_time is None:  # the run has not begun, or was aborted
            return None if self.seconds_left else self._held
        self.elapsed = now - self.start_time
        over = self.elapsed >= schedule.duration - 1e-6
        if (over or self._finishing) and self._progress.standing:
            self.abort(self._progress.standing)
            return self._held
        if over:
            self._end(PlaybackState.DONE, float(schedule.steering_motor_angle[-1]))
            return self._held
        if self._finishing:
            self._end(PlaybackState.DONE, self._held.steering_motor_angle, self._finishing)
            return self._held
        self._held = JointCommand(
            float(schedule.steering_motor_angle[row]) + self._led(now),
            float(schedule.wheel_rate[row]),
        )
        return self._held

    def _prepare(self, schedule: Schedule, now: float) -> None:
        """Count down, turn the wheels to their first angle, wait for rest; then the run begins."""
        if self._stood is None and now - self._asked_at >= WINDOW:
            self._stood = self._resting.mean()
        waited = now - self._asked_at - self.countdown
        self.seconds_left = max(0, math.ceil(-waited - 1e-6))
        if self.seconds_left:
            return
        first = float(schedule.steering_motor_angle[0])
        if waited < PREPARATION - 1e-6:
            self._held = JointCommand(first, 0.0)
            return
        late = waited >= PREPARATION + ARRIVAL - 1e-6
        unready = self.watch.turning(first, now, late=late) or self.watch.moves()
        unfit = self._displaced() or self._off_start()
        if unfit or (unready and late):
            self.abort(unfit or unready)
        elif not unready:
            # by the poses since the start was asked for: the vehicle may have moved before
            if self._plan is not None:
                self._line_keeping = self._line_keeping_of(self._plan) or self._line_keeping
            self.start_time, self.state = now, PlaybackState.RUNNING

    def _line_keeping_of(self, plan: _Plan) -> LineKeeping | None:
        """Return the line keeping of a plan's lead-in, from the resting pose; None without one."""
        end, pose = self.parts.lead_in_end(plan.stamp), self._resting.mean()
        return None if end == 0.0 or pose is None else LineKeeping(pose, end, self.chassis)

    def _fence_of(self, plan: _Plan) -> Fence | None:
        """Return the fence of a plan's area; None without an area."""
        rows = plan.schedule.time.size
        return self.parts.fence(plan.stamp, rows, needed=self.ground_needed)

    def _led(self, now: float) -> float:
        """Return the correction of the steering motor angle on the lead-in's line [rad]."""
        keeping, here = self._line_keeping, self.watch.observed
        if keeping is None or here is None or self.elapsed >= keeping.end - 1e-6:
            self._line_keeping = None
            return 0.0
        pose = here.after(now - self.watch.stamp)
        return keeping.steer(pose, here.speed, here.yaw_rate, self.elapsed)

    @staticmethod
    def _row(schedule: Schedule, elapsed: float) -> int:
        """Row that is due."""
        # 1 µs: a tick that is due at a row's time plays that row whatever the rounding
        row = int(np.searchsorted(schedule.time, elapsed + 1e-6, side="right")) - 1
        return max(row, 0)  # a clock may step back a little

    def _fenced_out(self, schedule: Schedule, now: float, row: int) -> str:
        """Return where a stop would leave the area; empty if it would not."""
        if self._fence is None:
            return ""
        push = 0.0 if self.start_time is None else float(schedule.wheel_rate[row])
        led = 0.0 if self._line_keeping is None else self._line_keeping.curvature
        return self._trespass(self._fence, now, float(self._fence.curvature[row]) + led, push)

    def _rolls_out(self, now: float) -> bool:
        """Whether a maneuver is done and the vehicle, armed, is not known to rest yet."""
        return (
            self.state is PlaybackState.DONE
            and self._stopping_since is not None
            and not self.watch.disarmed
            and not self.watch.rests(now)
        )

    def _leaves(self, now: float) -> bool:
        """Whether the motor alone may not stop the vehicle on its area, e.g. on a slope."""
        if self._fence is None:
            return False
        return bool(self._trespass(self._fence, now, float(self._fence.curvature[-1]), 0.0))

    def _trespass(self, fence: Fence, now: float, curvature: float, push: float) -> str:
        if self.watch.observed is None:
            return "no pose on odom"
        return fence.trespass(
            self.watch.observed,
            age=now - self.watch.stamp,
            curvature=curvature,
            push=push,
        )

    def _end(self, state: PlaybackState, angle: float, reason: str = "") -> None:
        stop = state is PlaybackState.ABORTED and self.state in DRIVEN and not self.watch.disarmed
        self._held = JointCommand(angle, 0.0, stop)
        self.state, self.reason, self.seconds_left = state, reason, 0
        self._stopping_since, self._back = self._ticked_at, None

    def _take_next(self) -> None:
        if self._next is None:
            return
        self._plan, self._next = self._next, None
        self._anchor = None
        self._held = JointCommand(self._held.steering_motor_angle, 0.0)
        self.state, self.reason = PlaybackState.WAITING, ""
        self.start_time, self.elapsed = None, 0.0

    def _unfit(self, now: float, *, directed: bool) -> str:
        """Why the vehicle must not drive on; empty if it may. Closed loop it is `directed`."""
        return (
            self.watch.not_ready(now)
            or self.watch.released(now)
            or self.watch.pose_lost(now)
            or (self.watch.undirected() if directed else "")
            or self._contradiction
        )

    def _disobeys(self, now: float) -> str:
        """Why the vehicle would not be driven, and what to do; empty if it would."""
        reason = self.watch.not_ready(now)
        return f"{reason}; arm it (tricycle_bridge/arm)" if self.watch.disarmed else reason

    def _unwatched(self, now: float) -> str:
        """Why the vehicle cannot be watched; empty if it can."""
        reason = self.watch.pose_lost(now) or self._contradiction
        return f"{reason}; the vehicle drives only where it can be watched" if reason else ""

    def _displaced(self) -> str:
        """Return how far the vehicle was moved in the countdown; empty within the tolerances."""
        here = self._resting.mean()
        if here is None or self._stood is None:  # there was hardly a countdown
            return ""
        (x, y, yaw), (x0, y0, yaw0) = here, self._stood
        off, turn = math.hypot(x - x0, y - y0), abs(math.remainder(yaw - yaw0, math.tau))
        if off <= START_POSITION_TOLERANCE and turn <= START_HEADING_TOLERANCE:
            return ""
        return (
            f"the vehicle was moved during the countdown, by {off:.2f} m and "
            f"{math.degrees(turn):.1f} deg (at most {START_POSITION_TOLERANCE:g} m and "
            f"{math.degrees(START_HEADING_TOLERANCE):g} deg)"
        )

    def _off_start(self) -> str:
        """Return how far the vehicle rests from the planned start; empty within the tolerances."""
        observed, here = self.watch.observed, self._resting.mean()
        if self._fence is None or observed is None or here is None:
            return ""
        x, y, yaw = here
        return self._fence.off_start(replace(observed, x=x, y=y, yaw=yaw))

    def _astray(self) -> str:
        """Return how far the vehicle is off the path; empty within the limit."""
        if self.watch.observed is None or self._anchor is None:
            return "no pose on odom"
        observed, anchor = self.watch.observed, self._anchor
        here = seen_from(np.array([[observed.x, observed.y]]), anchor.x, anchor.y, anchor.yaw)
        deviation = math.inf
        for first, last in ((max(self._nearest - NEAR, 0), self._nearest + NEAR), (0, None)):
            distances = np.hypot(*(self._path[first:last] - here).T)
            self._nearest = first + int(np.argmin(distances))
            deviation = float(distances.min())
            if deviation <= self.max_deviation:
                return ""
        return f"{deviation:.2f} m off the path (limit {self.max_deviation:g} m)"
