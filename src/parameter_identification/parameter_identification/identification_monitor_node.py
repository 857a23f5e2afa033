"""identification_monitor: estimates of the unknown parameters while a maneuver is driven."""

import math
from collections import deque
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from pathlib import Path
from threading import Thread

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from nav_msgs.msg import Odometry
from nav_msgs.msg import Path as PathMessage
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Imu, JointState
from trajectory_msgs.msg import JointTrajectory

from excitation_planner.plan import Plan, load_plan
from excitation_planner.planning import check_vehicle
from parameter_identification.drives.measured import Sensor
from parameter_identification.drives.measured_from_bag import commands_of
from parameter_identification.drives.poses import planar, stamp_of
from parameter_identification.drives.recorded import TopicNames
from parameter_identification.estimation.prior import GaussianPrior
from parameter_identification.identification_file import load_identification_file
from parameter_identification.live_identification import (
    DriveVerdict,
    LiveIdentification,
    Moment,
    Planned,
)
from tricycle_core.diagnostics import Level, values_of
from tricycle_core.errors import ExcitationError, IdentificationError, message_of
from tricycle_core.frames import of_frame
from tricycle_core.joints import REAR_WHEEL_JOINT, STEERING_JOINT
from tricycle_core.maneuver_state import ManeuverState, PlaybackState
from tricycle_core.nodes import (
    LATCHED,
    RECORDED,
    NotTheExecutors,
    declare,
    overridable,
    run_node,
    take_waiting,
)
from tricycle_core.stamps import SECOND, seconds_of
from tricycle_sim.commands import Commands
from tricycle_sim.vehicle import Vehicle, load_vehicle

PERIOD = 1.0  # s of wall time between updates
LATE = 0.2  # s of wall time in which a sensor that has more samples tells one
TAKEN = 0.1  # s of wall time between looks for samples
SILENT = 2 * SECOND  # of the driver's state, which it repeats every half second of a drive
UNHEARD = 0.1  # s of the steering in a lead-in that may be missing
TOPIC = "identification/estimates"
SENSORS = QoSProfile(
    depth=1000, reliability=ReliabilityPolicy.BEST_EFFORT
)  # none is lost meanwhile


CLOCK_BEGAN_ANEW = "the clock of the samples began anew"

Learnt = tuple[Moment | None, DriveVerdict | None]


class _Fit:
    """A fit in a thread of its own, which does not keep the process from ending."""

    def __init__(
        self,
        learn: Callable[[], Learnt],
        plan_id: str,
        planned: Planned | None,
        after: Thread | None,
        *,
        last: bool,
    ) -> None:
        self.plan_id, self.planned, self.last = plan_id, planned, last
        self.told = True  # unless its drive is given up meanwhile
        self.outcome: Future[Learnt] = Future()
        self.thread = Thread(target=self._run, args=(learn, after), name="fit", daemon=True)
        self.thread.start()

    def _run(self, learn: Callable[[], Learnt], after: Thread | None) -> None:
        if after is not None:
            after.join()
        try:
            self.outcome.set_result(learn())
        except Exception as error:  # raised again where it is told
            self.outcome.set_exception(error)


def _other_vehicle(plan: Plan, vehicle: Vehicle) -> str:
    """Say what tells the vehicle of a plan from this one; empty where nothing does."""
    try:
        check_vehicle(plan, vehicle)
    except ExcitationError as error:
        return str(error)
    return ""


class IdentificationMonitor(Node):
    """Connects a `LiveIdentification` with its topics."""

    def __init__(self) -> None:
        super().__init__("identification_monitor")
        file = declare(self, "vehicle_file", "", "vehicle YAML; empty: the packaged tricycle")
        declare(
            self,
            "plan_file",
            "",
            "the plan whose prediction is compared; empty: none",
            read_only=False,
        )
        declare(
            self,
            "known_file",
            "",
            "identification.json of earlier drives; empty: only the ranges are known",
            read_only=False,
        )
        declare(self, "targets", "", "parameters to be known, comma-separated", read_only=False)
        declare(
            self,
            "tolerance",
            0.0,
            "half width of the targets' 95 % intervals as a share of the estimates, from which "
            "they are said to be known; 0: never",
            (0.0, 1.0),
            read_only=False,
        )
        self._vehicle = load_vehicle(Path(file) if file else None)
        if not self._vehicle.unknown:
            raise IdentificationError(
                f"vehicle_file: {self._vehicle.name} has no unknown parameter: nothing to identify"
            )
        self._live = LiveIdentification(self._vehicle)
        self._live.prepare()  # not in the middle of a drive
        self._fits: deque[_Fit] = deque()  # under way, or not told yet
        self._commands: dict[str, Commands] = {}  # the newest by plan id
        self._stamp = 0  # of these commands
        self._lead_ins: dict[int, float] = {}  # the newest by stamp: its end
        self._known: GaussianPrior | None = None  # before these commands
        self._planned: Planned | None = None  # of these commands
        self._another_vehicle = ""  # that these commands were planned for, and which
        self._refused: int | None = None  # start of the drive that is not identified, ns
        self._commander = ""  # frame id of the driver's set-points; empty: not told
        self._running: int | None = None  # start of the drive under way, ns
        self._heard = 0  # until when the driver has told its state, ns
        self._ended = math.inf  # when the newest drive ended early, s since its start
        self._plan_id = ""  # of the newest drive
        self._estimates = self.create_publisher(DiagnosticStatus, TOPIC, **overridable(LATCHED))
        topics = TopicNames()
        for kind, topic, callback in (
            (JointTrajectory, topics.commands, self._on_commands),
            (PathMessage, topics.lead_in, self._on_lead_in),
            (DiagnosticStatus, topics.state, self._on_state),
        ):
            self.create_subscription(kind, topic, callback, **overridable(LATCHED))
        # the executor's wait for each message would take most of the processor time
        many = NotTheExecutors()
        self._many = [
            self.create_subscription(kind, topic, callback, callback_group=many, **overridable(qos))
            for kind, topic, callback, qos in (
                (JointState, topics.played, self._on_played, RECORDED),
                (Odometry, topics.pose, self._on_odom, SENSORS),
                (Imu, topics.imu, self._on_imu, SENSORS),
                (JointState, topics.joint_states, self._on_joints, SENSORS),
            )
        ]
        steady = Clock(clock_type=ClockType.STEADY_TIME)  # a simulation may be fast
        self.create_timer(TAKEN, self._take, clock=steady)
        self.create_timer(PERIOD, self._update, clock=steady)
        self.create_timer(LATE, self._tell_fitted, clock=steady)
        self._late = self.create_timer(LATE, self._end, clock=steady, autostart=False)

    def _take(self) -> None:
        """Take the samples and set-points that have come."""
        for subscription in self._many:
            for message, _ in take_waiting(subscription, SENSORS.depth):
                subscription.callback(message)

    def _on_odom(self, message: Odometry) -> None:
        wanted = TopicNames().child_frame
        if not of_frame(message.child_frame_id, wanted):
            self.get_logger().warning(
                f"{self.resolve_topic_name(TopicNames().pose)}: poses of {message.child_frame_id} "
                f"are ignored: those of {wanted} are needed",
                once=True,
            )
            return
        x, y, heading = planar(message.pose.pose)
        self._live.sense(Sensor.POSITION, stamp_of(message), (x, y))
        self._live.sense(Sensor.HEADING, stamp_of(message), (heading,))

    def _on_imu(self, message: Imu) -> None:
        if message.angular_velocity_covariance[0] != -1.0:  # there is one (REP-145)
            self._live.sense(Sensor.YAW_RATE, stamp_of(message), (message.angular_velocity.z,))
        if message.linear_acceleration_covariance[0] != -1.0:
            sideways = message.linear_acceleration.y
            self._live.sense(Sensor.LATERAL_ACCELERATION, stamp_of(message), (sideways,))

    def _on_joints(self, message: JointState) -> None:
        angle = dict(zip(message.name, message.position, strict=False)).get(STEERING_JOINT)
        if angle is not None:
            self._live.steer(angle)
        rate = dict(zip(message.name, message.velocity, strict=False)).get(REAR_WHEEL_JOINT)
        if rate is not None:
            self._live.sense(Sensor.WHEEL_SPEED, stamp_of(message), (rate,))

    def _on_commands(self, message: JointTrajectory) -> None:
        plan_id = message.header.frame_id
        try:
            commands = commands_of(message, self._vehicle, "maneuver/commands")
        except IdentificationError as error:
            self.get_logger().error(f"refused: {error}")
            return
        self._commands = {plan_id: commands}
        self._stamp = stamp_of(message)
        self._known = self._prior()
        self._planned = self._prediction(plan_id)

    def _on_lead_in(self, message: PathMessage) -> None:
        end = max((seconds_of(pose.header.stamp) for pose in message.poses), default=0.0)
        self._lead_ins = {stamp_of(message): end}

    def _on_played(self, message: JointState) -> None:
        """Take a set-point of the driver, which steers the lead-in itself."""
        if self._commander and message.header.frame_id != self._commander:
            return  # the bridge refuses it, too
        angle = dict(zip(message.name, message.position, strict=False)).get(STEERING_JOINT)
        if angle is not None:
            self._live.play(stamp_of(message), angle)

    def _prediction(self, plan_id: str) -> Planned | None:
        """Return what the plan of that id predicts; None, with the reason logged, if none does."""
        file = self.get_parameter("plan_file").value
        self._another_vehicle = ""
        if not file:
            return None
        try:
            plan = load_plan(Path(file))
            if plan.id == plan_id:
                self._another_vehicle = _other_vehicle(plan, self._vehicle)
                if not self._another_vehicle:
                    return Planned.of(plan, self._vehicle, self._known)
            why = self._another_vehicle or f"{file} holds plan {plan.id}, not {plan_id}"
        except (ExcitationError, OSError) as error:
            why = message_of(error)
        self.get_logger().warning(f"no prediction: {why}")
        return None

    def _on_state(self, message: DiagnosticStatus) -> None:
        try:
            state = ManeuverState.from_values(values_of(message))
        except ValueError as error:
            self.get_logger().error(f"maneuver/state: {error}", throttle_duration_sec=10.0)
            return
        self._commander = state.commander
        if state.state is PlaybackState.RUNNING:
            if state.start_time != self._running:
                self._begin(state)
            self._heard = (state.start_time or 0) + round(state.elapsed * SECOND)
        elif self._running is not None and state.state.ended:
            self._running = None
            whole = state.state is PlaybackState.DONE and not state.reason
            self._ended = math.inf if whole else state.elapsed
            self._late.reset()
        elif self._running is not None:
            self._abandon(f"the driver is {state.state.value}")

    def _abandon(self, why: str) -> None:
        self._running = None
        self._live.abandon()
        self._forget_updates()
        self.get_logger().warning(f"{why}: the drive of plan {self._plan_id} gets no verdict")

    def _end(self) -> None:
        """Have told what the drive has shown, once its last samples have come."""
        self._take()
        if self._live.began_anew:
            self._late.cancel()
            self._abandon(CLOCK_BEGAN_ANEW)
        elif self._live.complete(self._ended):
            self._late.cancel()
            if (missing := self._live.unheard) > UNHEARD:
                self.get_logger().warning(
                    f"{self.resolve_topic_name(TopicNames().played)}: the steering in the first "
                    f"{missing:.1f} s of the lead-in was not heard; the plan's is taken for it"
                )
            whole, ended = self._live.snapshot(), self._ended
            self._live.abandon()  # the samples of the next drive are not this one's
            self._learn(lambda: whole.end(ended), last=True)

    def _begin(self, state: ManeuverState) -> None:
        commands = self._commands.get(state.plan_id)
        if commands is None or state.start_time is None:
            self.get_logger().warning(
                f"the commands of plan {state.plan_id} were not heard: nothing is identified",
                throttle_duration_sec=10.0,
            )
            return
        if self._another_vehicle:
            if self._refused != state.start_time:
                self._refused = state.start_time
                why = f"nothing is identified: {self._another_vehicle}; vehicle_file must name it"
                self._publish(Level.WARN, why, {"plan_id": state.plan_id})
            return
        self._late.cancel()
        self._forget_updates()
        self._running, self._plan_id = state.start_time, state.plan_id
        lead_in = self._lead_ins.get(self._stamp, 0.0)
        self._live.begin(commands, state.start_time, self._planned, self._known, lead_in)

    def _prior(self) -> GaussianPrior | None:
        """Return what earlier drives have shown; None, with the reason logged, if they cannot."""
        if not (file := self.get_parameter("known_file").value):
            return None
        try:
            found = load_identification_file(Path(file))
            if found.vehicle_hash == self._vehicle.fingerprint:
                return found.posterior()
            why = f"{file} is of another vehicle, {found.vehicle} ({found.vehicle_hash})"
        except (ExcitationError, OSError) as error:
            why = message_of(error)
        self.get_logger().warning(f"earlier drives do not count: {why}")
        return None

    def _enough(self, moment: Moment) -> bool | None:
        """Whether every target is known within the tolerance; None if that is not asked."""
        tolerance = self.get_parameter("tolerance").value
        given = self.get_parameter("targets").value.split(",")
        targets = [name for one in given if (name := one.strip())]
        if not tolerance or not targets:
            return None
        if unknown := set(targets) - set(moment.parameters):
            self.get_logger().warning(
                f"targets: {', '.join(sorted(unknown))}: no unknown parameter of "
                f"{self._vehicle.name}; there are: {', '.join(moment.parameters)}",
                throttle_duration_sec=10.0,
            )
            return None
        return moment.known(targets, tolerance)

    def _update(self) -> None:
        if self._running is None:
            return
        self._take()
        if self._live.began_anew:
            self._abandon(CLOCK_BEGAN_ANEW)
        elif self._live.newest(Sensor.POSITION) > self._heard + SILENT:
            self._abandon("the driver is silent")
        elif not self._fits:  # one that takes longer than the period is waited for
            so_far = self._live.snapshot()
            self._learn(lambda: (so_far.update(), None), last=False)

    def _learn(self, learn: Callable[[], Learnt], *, last: bool) -> None:
        """Begin a fit, whose samples are taken, in a thread: meanwhile the next ones are heard."""
        after = self._fits[-1].thread if self._fits else None
        self._fits.append(_Fit(learn, self._plan_id, self._planned, after, last=last))

    def _forget_updates(self) -> None:
        """Leave untold what fits during a drive that is given up show."""
        for fit in self._fits:
            fit.told = fit.told and fit.last

    def _tell_fitted(self) -> None:
        """Publish what fits have shown that have ended."""
        while self._fits and self._fits[0].outcome.done():
            fit = self._fits.popleft()
            if fit.told:
                self._tell(fit)

    def _tell(self, fit: "_Fit") -> None:
        """Publish what was learnt, or why nothing could be."""
        plan = {"plan_id": fit.plan_id}
        try:
            moment, verdict = fit.outcome.result()
        except IdentificationError as error:
            self._publish(Level.WARN, str(error), plan)
            return
        if moment is None:
            if fit.last:
                seen = "its samples show no motion, or were not heard"
                self._publish(Level.WARN, f"no verdict: {seen}", plan)
            return
        values = plan | {"elapsed": f"{moment.elapsed:.2f}"}
        enough = self._enough(moment)
        if enough is not None:
            values["known"] = str(enough).lower()
        for name, parameter in moment.parameters.items():
            values |= {
                name: f"{parameter.estimate:.6g}",
                f"{name} std": f"{parameter.standard_deviation:.4g}",
            }
            if parameter.planned is not None:
                values[f"{name} planned std"] = f"{parameter.planned:.4g}"
        if verdict is not None:
            values |= {
                "ratio": f"{verdict.ratio:.3f}",
                "informative": str(verdict.informative).lower(),
            }
            self._publish(Level.OK if verdict.informative else Level.WARN, str(verdict), values)
            return
        target = fit.planned.target if fit.planned else next(iter(moment.parameters))
        text = f"{moment.elapsed:.1f} s: {target} {moment.parameters[target]}"
        self._publish(Level.OK, text + ("; all targets are known" if enough else ""), values)

    def _publish(self, level: Level, text: str, values: Mapping[str, str]) -> None:
        self._estimates.publish(
            DiagnosticStatus(
                level=bytes([level]),
                name="identification_monitor: drive",
                message=text,
                values=[KeyValue(key=key, value=value) for key, value in values.items()],
            )
        )


def main() -> None:
    """Run the node."""
    run_node(IdentificationMonitor)
