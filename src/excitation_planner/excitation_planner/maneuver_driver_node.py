"""maneuver_driver: plays `maneuver/commands` on `joint_commands`, open loop, at 100 Hz.

On `~/go_back` it drives the vehicle back to the start, closed loop.
"""

import math
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import PolygonStamped, PoseStamped, TransformStamped
from nav_msgs.msg import Odometry, Path
from rclpy.clock import Clock, ClockType, JumpThreshold
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy, qos_profile_sensor_data
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, UInt8
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory, MultiDOFJointTrajectory

from excitation_planner.localisation import PlanarState
from excitation_planner.plan_parts import AreaParts
from excitation_planner.playback import Playback
from excitation_planner.preflight import RECORDER, Check, Report, clock, commanders, recording
from excitation_planner.schedule import MAX_ROWS, Schedule
from excitation_planner.vehicle_watch import CLOCK_TOLERANCE, VehicleWatch
from excitation_planner.way_back.pursuit import Chassis
from excitation_planner.way_back.search import RouteSearch
from tricycle_bridge.commands.kinematics import TurningGeometry
from tricycle_core.diagnostics import Level, values_of
from tricycle_core.errors import LinkError, PlanError
from tricycle_core.frames import MANEUVER
from tricycle_core.joint_trajectory import rows_of
from tricycle_core.joints import JOINTS, STEERING_JOINT
from tricycle_core.maneuver_state import ManeuverState, PlaybackState
from tricycle_core.namesakes import namesakes
from tricycle_core.nodes import LATCHED, RECORDED, declare, overridable, publisher_names, run_node
from tricycle_core.quantities import FloatArray
from tricycle_core.readiness import TOPIC as READINESS_TOPIC
from tricycle_core.readiness import Readiness
from tricycle_core.rotations import about_vertical, is_unit, yaw_of
from tricycle_core.stamps import SECOND, nanoseconds_of, seconds_of
from tricycle_core.timing import TICK

try:  # not among the wheels
    from tf2_msgs.msg import TFMessage
except ImportError:
    TFMessage = None

NEWEST = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)  # of any publisher
OVERTAKING = 1.0  # s of simulated time by which a pose may overtake its tick of /clock
PREFLIGHT_EVERY = 1.0  # s between looks at what a start needs
# beginnings of the names of diagnostics that the pre-flight shows
REPORTING = "tricycle_bridge: ", "trajectory_recorder: "
STATE_EVERY = 0.5  # s between repeated state messages while running
ORIGIN_EVERY = 0.5  # s at least between poses at which a maneuver would start
ORIGIN_STEP = 0.05  # m or rad by which they differ at least


def _schedule(message: JointTrajectory) -> Schedule:
    """Rows of a JointTrajectory; raises PlanError naming what is missing."""
    if sorted(message.joint_names) != sorted(JOINTS):
        raise PlanError(f"joint_names must be {', '.join(JOINTS)}")
    points = message.points
    if len(points) > MAX_ROWS:  # before each is looked at
        raise PlanError(f"{len(points)} rows; at most {MAX_ROWS}")
    for row, point in enumerate(points):
        if len(point.positions) != 2 or len(point.velocities) != 2:
            raise PlanError(f"row {row} needs two positions and two velocities")
    return Schedule(*rows_of(message).T)


def _points(message: Path) -> FloatArray:
    """Positions of a path, shape (m, 2); raises PlanError where there are too many."""
    if len(message.poses) > MAX_ROWS:
        raise PlanError(f"{len(message.poses)} points; at most {MAX_ROWS}")
    positions = [pose.pose.position for pose in message.poses]
    return np.array([(p.x, p.y) for p in positions]).reshape(-1, 2)


def _planar_state(message: Odometry) -> PlanarState:
    position, velocity = message.pose.pose.position, message.twist.twist.linear
    orientation = message.pose.pose.orientation
    yaw = yaw_of(orientation) if is_unit(orientation) else math.nan
    return PlanarState(
        position.x,
        position.y,
        yaw,
        math.hypot(velocity.x, velocity.y),
        math.atan2(velocity.y, velocity.x),
        message.twist.twist.angular.z,
        message.header.frame_id,
        message.child_frame_id,
    )


def _ground(message: PolygonStamped) -> AreaParts:
    """Frame and rings; z of a corner is the number of its ring."""
    corners = [(p.x, p.y, p.z) for p in message.polygon.points]
    if len(corners) > MAX_ROWS:
        raise PlanError(f"{len(corners)} corners; at most {MAX_ROWS}")
    x, y, ring = np.array(corners).reshape(-1, 3).T
    points = np.column_stack([x, y])
    rings = tuple(points[ring == number] for number in np.unique(ring))
    return {"ground": (message.header.frame_id, rings)}


def _footprint(message: PolygonStamped) -> AreaParts:
    return {"footprint": np.array([(p.x, p.y) for p in message.polygon.points]).reshape(-1, 2)}


def _planned_start(message: PoseStamped) -> AreaParts:
    position, orientation = message.pose.position, message.pose.orientation
    if not is_unit(orientation):
        raise PlanError("orientation is not a unit quaternion")
    return {"planned_start": (position.x, position.y, yaw_of(orientation))}


def _twist(message: MultiDOFJointTrajectory) -> AreaParts:
    """Curvature: the turn rate at 1 m/s."""
    if any(len(point.velocities) != 1 for point in message.points):
        raise PlanError("every row needs one velocity")
    return {"twist": np.array([point.velocities[0].angular.z for point in message.points])}


def _summary(playback: Playback) -> str:
    """State, and why a run ended before its last command."""
    return ": ".join(filter(None, (playback.state.value, playback.reason)))


AREA_MESSAGES: dict[str, tuple[type, Callable[[Any], AreaParts]]] = {
    "ground": (PolygonStamped, _ground),
    "footprint": (PolygonStamped, _footprint),
    "planned_start": (PoseStamped, _planned_start),
    "twist": (MultiDOFJointTrajectory, _twist),
}


class ManeuverDriver(Node):
    """Connects a `Playback` with its topics, services and the 100 Hz timer."""

    def __init__(self) -> None:
        super().__init__("maneuver_driver")
        self._name = self.get_fully_qualified_name()
        self._ticked = time.monotonic()
        self._simulated = bool(self.get_parameter("use_sim_time").value)
        self._playback = self._declared_playback()
        self._recording_needed = declare(
            self, "recording_needed", False, "refuse to start while no bag is recorded"
        )
        self._routes = RouteSearch()
        self._published: tuple[object, ...] = ()  # content of the last maneuver/state
        self._reports: dict[str, Report] = {}  # of other nodes, by the name of their part
        self._origin: PlanarState | None = None  # last one published
        self._origin_at = -math.inf
        self._odom_frame = ""
        self._advertise()
        self._subscribe()
        self._start_ticking()

    def _declared_playback(self) -> Playback:
        """Return a playback with the limits that the node's parameters have."""
        deviation = declare(self, "max_deviation", 3.0, "m off the path that end a run", (0.1, 100))
        pose = declare(self, "odom_timeout", 0.5, "s without pose that end a run", (0.05, 10))
        state = declare(
            self, "state_timeout", 1.0, f"s without {READINESS_TOPIC} that end a run", (1.0, 20.0)
        )
        countdown = declare(
            self, "countdown", 0.0, "s from ~/start to the first command", (0.0, 60.0)
        )
        hold = declare(
            self,
            "hold_timeout",
            0.0,
            "s without maneuver/hold that end a run; 0: none has to be held",
            (0.0, 1.0),
        )
        unfenced = declare(
            self,
            "unfenced_plans",
            False,
            "drive commands that come without maneuver/ground, from publishers that have none",
        )
        watch = VehicleWatch(
            odom_timeout=pose,
            state_timeout=state,
            commander=self._name,
            clock_tolerance=OVERTAKING if self._simulated else CLOCK_TOLERANCE,
            hold_timeout=hold,
        )
        return Playback(
            watch,
            max_deviation=deviation,
            countdown=countdown,
            ground_needed=not unfenced,
            chassis=self._chassis(),
        )

    def _advertise(self) -> None:
        def latched(kind: type, topic: str) -> Any:
            return self.create_publisher(kind, topic, **overridable(LATCHED))

        self._joints = self.create_publisher(JointState, "joint_commands", **overridable(RECORDED))
        self._state = latched(DiagnosticStatus, "maneuver/state")
        self._preflight = latched(DiagnosticArray, "maneuver/preflight")
        self._running = latched(Bool, "maneuver/running")
        self._countdown = latched(UInt8, "maneuver/countdown")
        self._start = latched(PoseStamped, "maneuver/start")
        self._static = TFMessage and latched(TFMessage, "/tf_static")

    def _subscribe(self) -> None:
        for kind, topic, callback, qos in (
            (JointTrajectory, "maneuver/commands", self._on_commands, LATCHED),
            (Path, "maneuver/path", self._on_path, LATCHED),
            (Path, "maneuver/lead_in", self._on_lead_in, LATCHED),
            (Odometry, "odom", self._on_odom, qos_profile_sensor_data),
            (DiagnosticStatus, READINESS_TOPIC, self._on_readiness, LATCHED),
            (Bool, "maneuver/hold", self._on_hold, qos_profile_sensor_data),
            (JointState, "joint_states", self._on_joint_states, NEWEST),
            (DiagnosticArray, "/diagnostics", self._on_diagnostics, 10),
        ):
            self.create_subscription(kind, topic, callback, **overridable(qos))
        for part, (kind, read) in AREA_MESSAGES.items():
            callback = partial(self._on_area, part, read)
            self.create_subscription(kind, f"maneuver/{part}", callback, **overridable(LATCHED))
        for name, service in (
            ("~/preflight", self._on_preflight),
            ("~/start", self._on_start),
            ("~/go_back", self._on_go_back),
            ("~/finish", self._on_finish),
            ("~/abort", self._on_abort),
        ):
            self.create_service(Trigger, name, service)

    def _start_ticking(self) -> None:
        steady = Clock(clock_type=ClockType.STEADY_TIME)  # also while /clock stands still
        self.create_timer(PREFLIGHT_EVERY, self._publish_preflight, clock=steady)
        if self._simulated:
            # a timer may miss ticks of a clock that runs fast; the clock's own callback does not
            every_tick = JumpThreshold(
                min_forward=Duration(nanoseconds=1),
                min_backward=Duration(nanoseconds=-1),
                on_clock_change=False,
            )
            self._jumps = self.get_clock().create_jump_callback(
                every_tick, post_callback=lambda _: self._on_tick()
            )
        else:
            # on the computer's clock it would rest after this was set back, and nobody would see it
            self.create_timer(TICK, self._on_tick, clock=steady)

    def _chassis(self) -> Chassis:
        """Return the vehicle's geometry by the node's parameters, for the way back."""
        own, geometry = Chassis(), TurningGeometry()
        try:
            geometry = TurningGeometry(
                declare(self, "wheelbase", geometry.wheelbase, "m", (0.1, 10.0)),
                declare(
                    self, "motor_angles", list(geometry.motor_angles), "rad, of the steering motor"
                ),
                declare(
                    self,
                    "road_angles",
                    list(geometry.road_angles),
                    "rad, at motor_angles, of the one front wheel that would turn the vehicle so",
                ),
            )
        except LinkError as error:
            raise PlanError(str(error)) from error
        return Chassis(
            geometry,
            declare(
                self,
                "unsteered_axle",
                own.unsteered_axle,
                "m ahead of base_link, of its middle",
                (-10.0, 10.0),
            ),
            declare(self, "tyre_radius", own.tyre_radius, "m, of the driven wheel", (0.02, 1.0)),
        )

    def destroy_node(self) -> None:
        """End the search for a route, then destroy."""
        self._routes.close()
        super().destroy_node()

    def _now(self) -> float:
        return float(self.get_clock().now().nanoseconds) * 1e-9

    def _on_commands(self, message: JointTrajectory) -> None:
        playback = self._playback
        plan_id = message.header.frame_id  # a joint trajectory has no frame: see the planner
        try:
            playback.load(_schedule(message), nanoseconds_of(message.header.stamp), plan_id)
        except PlanError as error:
            self.get_logger().error(f"maneuver/commands refused: {error}")
            return
        if playback.plan_id != plan_id:
            self.get_logger().info(f"plan {plan_id} is taken when the vehicle rests after the run")

    def _on_path(self, message: Path) -> None:
        try:
            self._playback.parts.add_path(_points(message), nanoseconds_of(message.header.stamp))
        except PlanError as error:
            self.get_logger().error(f"maneuver/path refused: {error}")

    def _on_lead_in(self, message: Path) -> None:
        end = max((seconds_of(pose.header.stamp) for pose in message.poses), default=0.0)
        try:
            self._playback.parts.add_lead_in(end, nanoseconds_of(message.header.stamp))
        except PlanError as error:
            self.get_logger().error(f"maneuver/lead_in refused: {error}")

    def _on_area(self, part: str, read: Callable[[Any], AreaParts], message: Any) -> None:
        try:
            self._playback.parts.add_area(read(message), nanoseconds_of(message.header.stamp))
        except PlanError as error:
            self.get_logger().error(f"maneuver/{part} refused: {error}")

    def _on_odom(self, message: Odometry) -> None:
        stamp = seconds_of(message.header.stamp)
        self._odom_frame = message.header.frame_id
        self._playback.observe(_planar_state(message), stamp, self._now())

    def _on_readiness(self, message: DiagnosticStatus) -> None:
        self._playback.hear(Readiness.from_values(values_of(message)), self._now())

    def _on_hold(self, message: Bool) -> None:
        self._playback.hold(message.data, self._now())

    def _on_joint_states(self, message: JointState) -> None:
        angle = dict(zip(message.name, message.position, strict=False)).get(STEERING_JOINT)
        if angle is not None:
            self._playback.watch.steer(angle, self._now())

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name.startswith(REPORTING):
                level, now = Level.of(status.level), self._clocks()
                report = Report(level, status.message, now, values_of(status))
                self._reports[status.name] = report

    def _clocks(self) -> tuple[float, float]:
        """Present time on the node's clock, which may be a simulation's, and the computer's [s]."""
        return self._now(), time.monotonic()

    def _others(self) -> tuple[Check, ...]:
        """Items of the pre-flight that are not the playback's."""
        now, needed = self._clocks(), self._recording_needed
        bag = self._reports.get(RECORDER)
        return (
            self._clock_check(),
            *(self._reports[n].check(n, now) for n in sorted(self._reports) if n != RECORDER),
            commanders(self._name, self._commanding()),
            recording(bag, self._playback.duration, now, needed=needed),
        )

    def _commanding(self) -> list[str]:
        """Names of all publishers of commands, the own one among them."""
        return publisher_names(self, "joint_commands")

    def _clock_check(self) -> Check:
        return clock(time.monotonic() - self._ticked, simulated=self._simulated)

    def _checks(self) -> tuple[Check, ...]:
        """All items of the pre-flight."""
        return *self._playback.preflight(self._now()), *self._others()

    def _on_preflight(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        checks = self._checks()
        response.success = all(check.level is not Level.ERROR for check in checks)
        response.message = "\n".join(
            f"{check.level.name:5}  {check.name}: {check.message}" for check in checks
        )
        return response

    def _publish_preflight(self) -> None:
        if self._playback.state.driving:
            # the vehicle obeys both as one, and either may answer ~/abort
            own = (name for name in self._commanding() if name == self._name)
            if doubled := namesakes(own):
                self._playback.abort(doubled)
            return
        message = DiagnosticArray(
            status=[
                DiagnosticStatus(level=bytes([c.level]), name=c.name, message=c.message)
                for c in self._checks()
            ]
        )
        message.header.stamp = self.get_clock().now().to_msg()
        self._preflight.publish(message)

    def _on_start(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        started = f"started plan {self._playback.plan_id}".strip()
        self._attempt(
            response,
            lambda: self._playback.start(self._now(), self._others()),
            started,
            drives=True,
        )
        if response.success and not self._playback.fenced:
            self.get_logger().warning(
                "the plan has no area: only max_deviation, "
                f"{self._playback.max_deviation:g} m, limits where the vehicle goes"
            )
        return response

    def _on_go_back(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        return self._attempt(
            response,
            lambda: self._playback.go_back(self._now(), self._others()),
            "going back",
            drives=True,
        )

    def _look_for_route(self) -> None:
        """Have the route that is wanted looked for, and hand it over when it is found."""
        try:
            route = self._routes.route(self._playback.route_wanted)
            if route is not None:
                self._playback.follow(route)
        except PlanError as error:
            self._playback.abort(str(error))

    def _on_finish(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        return self._attempt(response, lambda: self._playback.finish("ended early"), "finishing")

    def _on_abort(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        return self._attempt(response, lambda: self._playback.abort("asked for"), "aborted")

    def _attempt(
        self,
        response: Trigger.Response,
        action: Callable[[], None],
        done: str,
        *,
        drives: bool = False,
    ) -> Trigger.Response:
        refusal = ""
        # where the clock stands still the last run would never end
        if drives and (check := self._clock_check()).level is Level.ERROR:
            refusal = check.message
        else:
            try:
                action()
            except PlanError as error:
                refusal = str(error)
        if refusal:
            self.get_logger().warning(f"refused: {refusal}")
        response.success, response.message = not refusal, refusal or done
        return response

    def _on_tick(self) -> None:
        self._look_for_route()
        before, self._ticked = self._ticked, time.monotonic()
        held_up = 0.0 if self._simulated else self._ticked - before
        now = self.get_clock().now()
        command = self._playback.tick(float(now.nanoseconds) * 1e-9, held_up)
        if command is not None:
            message = JointState()
            message.header.stamp = now.to_msg()
            message.header.frame_id = self._name  # who commands: joints have no frame
            if not command.stop:
                message.name = list(JOINTS)
                message.position = [command.steering_motor_angle, 0.0]
                message.velocity = [0.0, command.wheel_rate]
            self._joints.publish(message)
        self._publish_state()
        self._publish_origin()

    def _publish_origin(self) -> None:
        """Publish where path and reference lie: at the start; before it when the vehicle moves."""
        origin, last, now = self._playback.origin, self._origin, self._now()
        if origin is None or origin is last or not self._playback.duration:
            return
        if last is not None and not self._playback.anchored:
            turn = math.remainder(origin.yaw - last.yaw, math.tau)
            step = max(math.hypot(origin.x - last.x, origin.y - last.y), abs(turn))
            if step < ORIGIN_STEP or 0 <= now - self._origin_at < ORIGIN_EVERY:
                return
        self._origin, self._origin_at = origin, now
        pose = PoseStamped()
        pose.header.stamp = self.get_clock().now().to_msg()
        pose.header.frame_id = self._odom_frame
        position, orientation = pose.pose.position, pose.pose.orientation
        position.x, position.y = origin.x, origin.y
        orientation.z, orientation.w = about_vertical(origin.yaw)
        self._start.publish(pose)
        if self._static is not None:
            transform = TransformStamped(header=pose.header, child_frame_id=MANEUVER)
            translation = transform.transform.translation
            translation.x, translation.y = origin.x, origin.y
            transform.transform.rotation = orientation
            self._static.publish(TFMessage(transforms=[transform]))

    def _log_state(self) -> None:
        playback = self._playback
        if playback.state is PlaybackState.ABORTED:
            self.get_logger().warning(_summary(playback))
        else:
            self.get_logger().info(f"{_summary(playback)}, plan {playback.plan_id}")

    def _publish_state(self) -> None:
        """Publish the state when it changes, and every `STATE_EVERY` while running."""
        playback = self._playback
        beat = int(playback.elapsed / STATE_EVERY)
        left = playback.seconds_left
        content = (playback.state, playback.plan_id, playback.start_time, beat, left)
        if content == self._published:
            return
        if left != (self._published[-1] if self._published else 0):
            self._countdown.publish(UInt8(data=left))
            if left:
                self.get_logger().info(f"the drive begins in {left} s")
        if self._published and playback.state is not self._published[0]:
            self._log_state()
        self._published = content
        self._running.publish(Bool(data=playback.state is PlaybackState.RUNNING))
        start = playback.start_time
        values = ManeuverState(
            playback.state,
            playback.plan_id,
            None if start is None else round(start * SECOND),
            playback.elapsed,
            playback.duration,
            playback.reason,
            self._name,
        ).values()
        self._state.publish(
            DiagnosticStatus(
                level=bytes([Level.ERROR if playback.state is PlaybackState.ABORTED else Level.OK]),
                name="maneuver_driver: maneuver",
                message=_summary(playback),
                values=[KeyValue(key=key, value=value) for key, value in values.items()],
            )
        )


def main() -> None:
    """Run the node."""
    run_node(ManeuverDriver)
