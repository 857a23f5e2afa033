"""identification_monitor: estimates of the unknown parameters while a maneuver is driven."""

import math
from collections.abc import Callable, Mapping
from pathlib import Path

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from nav_msgs.msg import Odometry
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Imu, JointState
from trajectory_msgs.msg import JointTrajectory

from excitation_planner.plan import load_plan
from excitation_planner.planning import check_vehicle
from parameter_identification.drives.measured import Sensor, commands_of
from parameter_identification.drives.poses import planar, stamp_of
from parameter_identification.drives.recorded import TopicNames
from parameter_identification.live_identification import (
    LiveIdentification,
    Moment,
    Planned,
    Verdict,
)
from tricycle_core.diagnostics import Level
from tricycle_core.errors import ExcitationError, IdentificationError
from tricycle_core.joints import REAR_WHEEL_JOINT, STEERING_JOINT
from tricycle_core.maneuver_state import ManeuverState, PlaybackState
from tricycle_core.nodes import LATCHED, declare, overridable, run_node
from tricycle_sim.commands import Commands
from tricycle_sim.vehicle import load_vehicle

PERIOD = 1.0  # s of wall time between updates
TOPIC = "identification/estimates"
SENSORS = QoSProfile(
    depth=1000, reliability=ReliabilityPolicy.BEST_EFFORT
)  # none is lost meanwhile


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
        self._vehicle = load_vehicle(Path(file) if file else None)
        self._live = LiveIdentification(self._vehicle)
        self._commands: dict[str, Commands] = {}  # the newest by plan id
        self._planned: Planned | None = None  # of these commands
        self._running: int | None = None  # start of the drive under way, ns
        self._estimates = self.create_publisher(DiagnosticStatus, TOPIC, **overridable(LATCHED))
        topics = TopicNames()
        for kind, topic, callback, qos in (
            (JointTrajectory, topics.commands, self._on_commands, LATCHED),
            (DiagnosticStatus, topics.state, self._on_state, LATCHED),
            (Odometry, topics.pose, self._on_odom, SENSORS),
            (Imu, topics.imu, self._on_imu, SENSORS),
            (JointState, topics.joint_states, self._on_joints, SENSORS),
        ):
            self.create_subscription(kind, topic, callback, **overridable(qos))
        steady = Clock(clock_type=ClockType.STEADY_TIME)  # a simulation may be fast
        self.create_timer(PERIOD, self._update, clock=steady)

    def _on_odom(self, message: Odometry) -> None:
        x, y, heading = planar(message.pose.pose)
        self._live.sense(Sensor.POSITION, stamp_of(message), (x, y))
        if not math.isnan(heading):
            self._live.sense(Sensor.HEADING, stamp_of(message), (heading,))

    def _on_imu(self, message: Imu) -> None:
        self._live.sense(Sensor.YAW_RATE, stamp_of(message), (message.angular_velocity.z,))

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
        self._planned = self._prediction(plan_id)

    def _prediction(self, plan_id: str) -> Planned | None:
        """Return what the plan of that id predicts; None, with the reason logged, if none does."""
        file = self.get_parameter("plan_file").value
        if not file:
            return None
        try:
            plan = load_plan(Path(file))
            check_vehicle(plan, self._vehicle)
            if plan.id == plan_id:
                return Planned.of(plan, self._vehicle)
            why = f"{file} holds plan {plan.id}, not {plan_id}"
        except (ExcitationError, OSError) as error:
            why = str(error)
        self.get_logger().warning(f"no prediction: {why}")
        return None

    def _on_state(self, message: DiagnosticStatus) -> None:
        try:
            state = ManeuverState.from_values({pair.key: pair.value for pair in message.values})
        except ValueError as error:
            self.get_logger().error(f"maneuver/state: {error}", throttle_duration_sec=10.0)
            return
        if state.state is PlaybackState.RUNNING and state.start_time != self._running:
            self._begin(state)
        elif state.state.ended and self._running is not None:
            self._running = None
            done = state.state is PlaybackState.DONE
            self._tell(lambda: self._live.end(math.inf if done else state.elapsed))

    def _begin(self, state: ManeuverState) -> None:
        commands = self._commands.get(state.plan_id)
        if commands is None or state.start_time is None:
            self.get_logger().warning(
                f"the commands of plan {state.plan_id} were not heard: nothing is identified",
                throttle_duration_sec=10.0,
            )
            return
        self._running = state.start_time
        self._live.begin(commands, state.start_time, self._planned)

    def _update(self) -> None:
        if self._running is not None:
            self._tell(lambda: (self._live.update(), None))

    def _tell(self, learn: Callable[[], tuple[Moment | None, Verdict | None]]) -> None:
        """Publish what was learnt, or why nothing could be."""
        try:
            moment, verdict = learn()
        except IdentificationError as error:
            self._publish(Level.WARN, str(error), {})
            return
        if moment is None:
            return
        values = {"elapsed": f"{moment.elapsed:.2f}"}
        for name, found in moment.parameters.items():
            values |= {
                name: f"{found.estimate:.6g}",
                f"{name} std": f"{found.standard_deviation:.4g}",
            }
            if found.planned is not None:
                values[f"{name} planned std"] = f"{found.planned:.4g}"
        if verdict is not None:
            values |= {
                "ratio": f"{verdict.ratio:.3f}",
                "informative": str(verdict.informative).lower(),
            }
            self._publish(Level.OK if verdict.informative else Level.WARN, str(verdict), values)
            return
        target = self._planned.target if self._planned else next(iter(moment.parameters))
        text = f"{moment.elapsed:.1f} s: {target} {moment.parameters[target]}"
        self._publish(Level.OK, text, values)

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
