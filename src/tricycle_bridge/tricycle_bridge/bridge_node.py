"""The bridge as a lifecycle node: ROS messages to `Bridge`, `Bridge` to ROS messages.

Configure opens both ports and does the handshakes (and keeps trying), activate forwards commands,
deactivate stops safely, cleanup closes the ports.

What the ports receive is handled and published in their I/O thread, and commands are handled in a
thread of their own: waking the executor for them would take several times the CPU time. One lock
keeps the bridge to one thread at a time. On simulated time the executor does it all, so that a tick
of /clock is handled before what was sent at it.
"""

from __future__ import annotations

import dataclasses
import math
import os
import random
import threading
import time
from collections.abc import Callable, Mapping
from datetime import UTC, datetime, timedelta
from functools import partial
from pathlib import Path
from typing import Any

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import Twist, TwistStamped
from lifecycle_msgs.srv import ChangeState
from nav_msgs.msg import Odometry
from rcl_interfaces.msg import SetParametersResult
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.clock import JumpThreshold
from rclpy.duration import Duration
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.task import Future
from sensor_msgs.msg import BatteryState, Imu, JointState
from std_msgs.msg import Bool
from std_srvs.srv import SetBool, Trigger

from tricycle_bridge.arming import ArmingOutcome
from tricycle_bridge.bridge import Bridge
from tricycle_bridge.commands.command_messages import joint_command, twist_command
from tricycle_bridge.commands.command_stream import INPUT_LEAD, Source, VehicleCommand
from tricycle_bridge.commands.command_thread import CommandThread
from tricycle_bridge.commands.kinematics import TurningGeometry
from tricycle_bridge.commissioning.record import BringUpRecord, read_record
from tricycle_bridge.diagnosis import diagnose, vehicle_problem
from tricycle_bridge.host_clock import HostClock
from tricycle_bridge.measurements.joint_pairing import JointReadings
from tricycle_bridge.port_bridge import receive_all, send_all
from tricycle_bridge.protocol.messages import (
    BAUD,
    Board,
    DriveState,
)
from tricycle_bridge.protocol.readable import firmware_build
from tricycle_bridge.protocol.units import CURRENT_UNIT, VOLTAGE_UNIT
from tricycle_bridge.serial_port import IDLE_PERIOD, SerialPorts
from tricycle_bridge.settings import BridgeSettings
from tricycle_core.diagnostics import Level
from tricycle_core.errors import LinkError
from tricycle_core.nodes import (
    LATCHED,
    RECORDED,
    declare,
    overridable,
    publisher_names,
    run_node,
    time_message,
)
from tricycle_core.readiness import ARMED_TOPIC, PERIOD, TOPIC, Readiness
from tricycle_core.stamps import seconds_of, split_seconds

CLOCK_PERIOD = 0.05  # s between looks at the computer's clock
REPORT_PERIOD = 1.0  # s between diagnostics and battery states
# act at once, up to the value with which the bridge was configured
LOWERED_PARAMETERS = ("max_steering_angle", "max_steering_rate", "max_speed", "max_acceleration")
# may be set only while the bridge is not configured; the others act at once
CONFIGURED_PARAMETERS = (
    *("steer_port", "drive_port", "baud", "boot_wait", "bring_up_record", "bring_up_age"),
    *(field.name for field in dataclasses.fields(TurningGeometry)),
    *(
        field.name
        for field in dataclasses.fields(BridgeSettings)
        if field.name not in ("command_rate", "standstill_rate", *LOWERED_PARAMETERS)
    ),
)


class BridgeNode(LifecycleNode):
    """Node `tricycle_bridge`; topics, services and parameters are listed in docs/link.md."""

    def __init__(self) -> None:
        super().__init__("tricycle_bridge")
        self._declare_parameters()
        for service in self.services:
            if service.srv_type is ChangeState:
                service.callback = partial(_change_state, service.callback)
        self._lock = threading.RLock()  # guards the bridge, its ports and the attributes below
        self._bridge: Bridge | None = None
        self._ports: SerialPorts | None = None
        self._arm_when_ready = False
        self._configured = BridgeSettings()  # when it was configured last
        self._geometry = TurningGeometry()
        self._last_now = 0.0
        self._reported_at = -math.inf
        self._stated: object = None  # newest on vehicle/state
        self._stated_at = -math.inf

        # Default event handlers would double what the executor waits for, and so its CPU time.
        def publisher(kind: type, topic: str, qos: QoSProfile | int = 10) -> Any:
            silent = PublisherEventCallbacks(use_default_callbacks=False)
            return self.create_publisher(kind, topic, **overridable(qos), event_callbacks=silent)

        self._joint_states = publisher(JointState, "joint_states", RECORDED)
        self._message = JointState()  # filled anew each time: making one takes as long as sending
        self._battery_state = publisher(BatteryState, "battery_state")
        self._diagnostics = publisher(DiagnosticArray, "/diagnostics")
        self._vehicle_state = publisher(DiagnosticStatus, TOPIC, LATCHED)
        self._armed = publisher(Bool, ARMED_TOPIC, LATCHED)
        simulated = self._simulated = self.get_parameter("use_sim_time").value
        # of the computer's clock, which may be set while the vehicle moves, only stamps depend
        self._host_clock = None if simulated else HostClock(self._ros_now)
        self._clock_checked = -math.inf
        self._dead_thread = ""
        self._thread_died = self.create_guard_condition(self._on_dead_thread)
        ended = partial(self._on_thread_end, "commands")
        self._commands = None if simulated else CommandThread(self, ended)
        group = self._commands.group if self._commands else None
        stamped = self.get_parameter("cmd_vel_stamped").value
        newest = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)  # of any publisher
        for kind, topic, callback, qos in (
            # only the newest: an older one is of no use
            (JointState, "joint_commands", self._on_joint_commands, 1),
            (TwistStamped, "cmd_vel", self._on_twist_stamped, 1)
            if stamped
            else (Twist, "cmd_vel", self._on_twist, 1),
            (Odometry, "odom", self._on_odometry, newest),
            (Imu, "imu", self._on_imu, newest),
        ):
            self.create_subscription(
                kind, topic, callback, **overridable(qos), callback_group=group
            )
        # It awaits the boards, so it must not block the node's other callbacks.
        waiting = ReentrantCallbackGroup()
        self.create_service(SetBool, "~/arm", self._on_arm, callback_group=waiting)
        self.create_service(Trigger, "~/emergency_stop", self._on_emergency_stop)
        self.create_service(Trigger, "~/release", self._on_release)
        self._on_serial = self._step
        if simulated:
            self._on_serial = self.create_guard_condition(self._step).trigger
            # a simulation may wait for a command of every tick, also where telemetry came before it
            every_tick = JumpThreshold(
                min_forward=Duration(nanoseconds=1), min_backward=None, on_clock_change=False
            )
            self._clock_handle = self.get_clock().create_jump_callback(
                every_tick, post_callback=lambda _jump: self._on_serial()
            )

        if self.get_parameter("autostart").value:
            if problem := self._mistake():
                raise LinkError(problem)
            self.trigger_configure()
            self.trigger_activate()
        if self._commands:
            self._commands.start()

    def _declare_parameters(self) -> None:
        def add(
            name: str, default: Any, description: str, span: tuple[float, float] | None = None
        ) -> None:
            at_start = name in ("autostart", "cmd_vel_stamped")
            when = ""
            if name in CONFIGURED_PARAMETERS:
                when = "before configure"
            elif name in LOWERED_PARAMETERS:
                when = "lowered at any time"
            declare(self, name, default, description, span, read_only=at_start, constraints=when)

        add("steer_port", "/dev/tricycle_steer", "serial device of the steer PLC")
        add("drive_port", "/dev/tricycle_drive", "serial device of the drive PLC")
        add("baud", BAUD, "bits per second on both ports", (9600, 1_000_000))
        add("boot_wait", 2.0, "s of silence after opening: a UNO's bootloader", (0.0, 10.0))
        for field in dataclasses.fields(BridgeSettings):
            about = field.metadata
            add(field.name, field.default, about["description"], about["range"])
        geometry = TurningGeometry()
        add("wheelbase", geometry.wheelbase, "m, for cmd_vel", (0.1, 10.0))
        add(
            "motor_angles",
            list(geometry.motor_angles),
            "rad, rising, of the steering motor, for cmd_vel",
        )
        add(
            "road_angles",
            list(geometry.road_angles),
            "rad, at motor_angles, of the one front wheel that would turn the vehicle so",
        )
        add("cmd_vel_stamped", True, "cmd_vel is a TwistStamped; false: a Twist")
        add(
            "bring_up_record",
            "",
            "record of `tricycle plc check` that arming asks for; empty: none",
        )
        add("bring_up_age", 30.0, "days for which a bring-up holds", (0.1, 1000.0))
        add("autostart", True, "configure and activate at start, without a lifecycle manager")
        add("arm_on_activate", False, "arm once, when every precondition holds")
        self.add_on_set_parameters_callback(self._check_parameters)
        self.add_post_set_parameters_callback(self._on_parameters)

    def _check_parameters(self, parameters: list[Parameter]) -> SetParametersResult:
        """Refuse a change that would only act at the next configure."""
        if self._bridge is None:
            return SetParametersResult(successful=True)
        for parameter in parameters:
            name, reason = parameter.name, ""
            if name in CONFIGURED_PARAMETERS:
                if parameter.value != self.get_parameter(name).value:
                    reason = f"{name} is read when the bridge is configured: clean it up first"
            elif name in LOWERED_PARAMETERS:
                largest = getattr(self._configured, name)
                if parameter.value > largest:
                    reason = (
                        f"{name} = {parameter.value:g} is above {largest:g}, for which the boards "
                        "are set up: clean the bridge up first"
                    )
            if reason:
                return SetParametersResult(successful=False, reason=reason)
        asked = {parameter.name: parameter.value for parameter in parameters}
        try:  # rclpy takes values that are a millionth beyond their range
            self._settings(asked)
        except LinkError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _on_parameters(self, _parameters: list[Parameter]) -> None:
        if self._bridge is not None:
            self._bridge.settings = self._settings({})

    def _settings(self, asked: Mapping[str, Any]) -> BridgeSettings:
        """Return the settings by the node's parameters, some of them replaced by new values."""
        names = (field.name for field in dataclasses.fields(BridgeSettings))
        return BridgeSettings(
            **{name: asked.get(name, self.get_parameter(name).value) for name in names}
        )

    def _turning_geometry(self) -> TurningGeometry:
        names = (field.name for field in dataclasses.fields(TurningGeometry))
        return TurningGeometry(**{name: self.get_parameter(name).value for name in names})

    # ---- lifecycle ----

    def on_configure(self, _state: LifecycleState) -> TransitionCallbackReturn:
        """Open both ports and begin the handshakes; both are retried until they succeed."""
        if problem := self._mistake():
            self.get_logger().error(problem)
            return TransitionCallbackReturn.FAILURE
        steer, drive, baud, boot_wait = (
            self.get_parameter(name).value
            for name in ("steer_port", "drive_port", "baud", "boot_wait")
        )
        self._configured, self._geometry = self._settings({}), self._turning_geometry()
        self._bridge = Bridge(
            self._configured,
            rng=random.SystemRandom(),
            boot_wait=boot_wait,
            simulated=self._simulated,
        )
        if path := self.get_parameter("bring_up_record").value:
            record = read_record(Path(path))
            age = timedelta(days=self.get_parameter("bring_up_age").value)
            self._bridge.bring_up_problem = partial(self._bring_up_problem, record, age)
        self._ports = SerialPorts(
            {Board.STEER: steer, Board.DRIVE: drive},
            self._on_serial,
            ended=partial(self._on_thread_end, "serial ports"),
            baud=baud,
        )
        return TransitionCallbackReturn.SUCCESS

    def _bring_up_problem(self, record: BringUpRecord, age: timedelta) -> str | None:
        links = self._bridge.links if self._bridge is not None else {}
        firmware = {b: firmware_build(link.identity) for b, link in links.items() if link.identity}
        return record.problem(firmware, self._configured, datetime.now(UTC), age)

    def _mistake(self) -> str | None:
        """Return what is wrong with the parameters, if anything."""
        steer, drive = (self.get_parameter(f"{b}_port").value for b in ("steer", "drive"))
        device = os.path.realpath(steer)
        if device == os.path.realpath(drive):
            return f"steer_port and drive_port are both {device}"
        try:
            self._settings({})
            self._turning_geometry()
            if path := self.get_parameter("bring_up_record").value:
                read_record(Path(path))
        except LinkError as error:
            return str(error)
        return None

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Forward commands; arm only if the parameter `arm_on_activate` is set."""
        if self._bridge is not None:
            self._bridge.active = True
        self._arm_when_ready = self.get_parameter("arm_on_activate").value
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Let the vehicle come to rest and forward no more commands."""
        self._arm_when_ready = False
        if self._bridge is not None:
            with self._lock:
                self._bridge.active = False
                self._bridge.stop("the bridge was deactivated")
                self._step()
        return super().on_deactivate(state)

    def on_cleanup(self, _state: LifecycleState) -> TransitionCallbackReturn:
        """Close both ports."""
        self._close()
        return TransitionCallbackReturn.SUCCESS

    def on_shutdown(self, _state: LifecycleState) -> TransitionCallbackReturn:
        """Stop and close."""
        self._close()
        return TransitionCallbackReturn.SUCCESS

    def destroy_node(self) -> None:
        """Stop and close, then destroy."""
        if self._commands:
            self._commands.stop()
        self._close()
        super().destroy_node()

    def _close(self) -> None:
        with self._lock:
            if self._bridge is not None:
                # the boards are told at once: there is no next tick
                self._bridge.active = False
                self._bridge.stop("the bridge ends")
                self._bridge.poll(self._now())
                self._step()
                self._state(Readiness(False, "the bridge has ended"), Level.WARN, self._now())
            ports = self._ports
            self._ports = self._bridge = None
        if ports is not None:
            ports.close()  # waits for its thread, which may wait for the lock

    # ---- the loop: after serial data, after a command, and every 50 ms without serial data ----

    def _ros_now(self) -> float:
        # what ROS time is unless simulated, at a tenth of the CPU time
        return self.get_clock().now().nanoseconds * 1e-9 if self._simulated else time.time()

    def _now(self) -> float:
        """Time on the bridge's clock: the simulation's, otherwise one that nobody sets."""
        return self._ros_now() if self._host_clock is None else time.monotonic()

    def _ros_time(self, time_of_bridge: float) -> float:
        clock = self._host_clock
        return time_of_bridge if clock is None else clock.to_ros(time_of_bridge)

    def _time_of(self, stamp: Time, now: float) -> float:
        """Time of a stamp on the bridge's clock; 0 without a stamp."""
        wanted = seconds_of(stamp)
        if self._host_clock is None or wanted == 0.0:
            return wanted
        return now - (self._ros_now() - wanted)

    def _on_thread_end(self, name: str) -> None:
        """Have the executor end the node."""
        self._dead_thread = name
        self._thread_died.trigger()

    def _on_dead_thread(self) -> None:
        raise RuntimeError(f"the thread of the {self._dead_thread} died")

    def _follow_clock(self, clock: HostClock) -> None:
        self._clock_checked = time.monotonic()
        step = clock.find_step()
        if step is not None:
            self.get_logger().warning(
                f"this computer's clock was set by {step:+.3f} s; the bridge goes on"
            )

    def _step(self) -> None:
        with self._lock:
            bridge, ports = self._bridge, self._ports
            if bridge is None or ports is None:
                return
            now = self._now()
            if self._host_clock is not None and now - self._clock_checked >= CLOCK_PERIOD:
                self._follow_clock(self._host_clock)
            self._receive(bridge, ports, now)
            self._flush(bridge, ports, now)

    def _receive(self, bridge: Bridge, ports: SerialPorts, now: float) -> None:
        if now < self._last_now:
            bridge.restart_links(now, "the clock jumped back")
            self._reported_at = -math.inf
        self._last_now = now
        receive_all(bridge, ports, now)
        if self._arm_when_ready and bridge.refusal(now) is None:
            self._arm_when_ready = False
            bridge.arm(now, lambda outcome: self.get_logger().info(outcome.text))

    def _flush(self, bridge: Bridge, ports: SerialPorts, now: float) -> None:
        send_all(bridge, ports)
        for readings in bridge.take_readings():
            self._joint_states.publish(self._joint_state(readings))
        log = bridge.take_log()
        for level, text in log:
            # rclpy allows one severity per line of code
            if level is Level.WARN:
                self.get_logger().warning(text)
            else:
                self.get_logger().info(text)
        problem = vehicle_problem(bridge, now)
        readiness = bridge.readiness(now)
        level = Level.OK if readiness.armed else Level.WARN
        self._state(readiness, level if problem is None else Level.ERROR, now, problem or "")
        if log or now - self._reported_at >= REPORT_PERIOD:
            self._reported_at = now
            self._report(bridge, now)

    def _joint_state(self, readings: JointReadings) -> JointState:
        message = self._message
        stamp = message.header.stamp
        stamp.sec, stamp.nanosec = split_seconds(self._ros_time(readings.stamp))
        message.name, message.position, message.velocity = zip(*readings.joints, strict=True)
        return message

    def _state(self, readiness: Readiness, level: Level, now: float, problem: str = "") -> None:
        """Publish the vehicle's state when it has changed, and before `PERIOD` is over."""
        content = (readiness, level, problem)
        if content == self._stated and 0.0 <= now - self._stated_at < PERIOD - IDLE_PERIOD:
            return
        self._stated, self._stated_at = content, now
        text = problem or ("armed" if readiness.armed else f"not armed: {readiness.reason}")
        status = DiagnosticStatus(
            level=bytes([level]), name="tricycle_bridge: vehicle", message=text
        )
        status.values = [KeyValue(key=k, value=v) for k, v in readiness.values().items()]
        self._vehicle_state.publish(status)
        self._armed.publish(Bool(data=readiness.armed))

    def _report(self, bridge: Bridge, now: float) -> None:
        stamp = time_message(self._ros_time(now))
        publishers = {source: publisher_names(self, source.value) for source in Source}
        array = DiagnosticArray()
        array.header.stamp = stamp
        for diagnosis in diagnose(bridge, now, publishers):
            status = DiagnosticStatus(
                level=bytes([diagnosis.level]), name=diagnosis.name, message=diagnosis.message
            )
            status.values = [KeyValue(key=k, value=v) for k, v in diagnosis.values.items()]
            array.status.append(status)
        self._diagnostics.publish(array)
        telemetry = bridge.links[Board.DRIVE].telemetry
        if isinstance(telemetry, DriveState):
            battery = BatteryState(
                voltage=telemetry.supply * VOLTAGE_UNIT,
                current=-telemetry.current * CURRENT_UNIT,  # negative while discharging
                charge=math.nan,
                capacity=math.nan,
                design_capacity=math.nan,
                percentage=math.nan,
                temperature=math.nan,
                power_supply_status=BatteryState.POWER_SUPPLY_STATUS_DISCHARGING,
                present=True,
            )
            battery.header.stamp = stamp
            self._battery_state.publish(battery)

    # ---- commanders ----

    def _on_joint_commands(self, message: JointState) -> None:
        def command(bridge: Bridge) -> VehicleCommand | None:
            if not message.name:
                return None
            radius = bridge.settings.tyre_radius
            return joint_command(message.name, message.position, message.velocity, radius)

        stamp, name = message.header.stamp, message.header.frame_id
        self._command(command, stamp, Source.JOINT_COMMANDS, name)

    def _on_twist_stamped(self, message: TwistStamped) -> None:
        self._on_twist(message.twist, message.header.stamp)

    def _on_twist(self, twist: Twist, stamp: Time | None = None) -> None:
        def command(bridge: Bridge) -> VehicleCommand:
            return twist_command(
                twist.linear.x,
                twist.angular.z,
                bridge.settings,
                self._geometry,
                resting_angle=bridge.resting_angle(),
            )

        self._command(command, stamp, Source.CMD_VEL)

    def _command(
        self,
        make: Callable[[Bridge], VehicleCommand | None],
        stamp: Time | None,
        source: Source,
        name: str = "",
    ) -> None:
        """Give a command to the bridge, None as a stop; without a stamp it counts as sent now."""
        with self._lock:
            bridge, ports = self._bridge, self._ports
            if bridge is None or ports is None or not bridge.active:
                return
            now = self._now()
            self._receive(bridge, ports, now)  # the echo must be of the newest telemetry
            wanted = now if stamp is None else self._time_of(stamp, now)
            if self._host_clock is None and now < wanted <= now + INPUT_LEAD:
                now = wanted  # the tick of /clock at which the message was made has not come yet
            refusal: str | None
            try:
                command = make(bridge)
            except LinkError as error:
                refusal = bridge.refuse_command(
                    str(error), stamp=wanted, now=now, source=source, name=name
                )
            else:
                refusal = bridge.set_command(
                    command, stamp=wanted, now=now, source=source, name=name
                )
            self._flush(bridge, ports, now)
        if refusal is not None:
            self._log_throttled(refusal)

    def _on_odometry(self, message: Odometry) -> None:
        with self._lock:
            if self._bridge is not None:
                self._bridge.set_odometry(message.twist.twist.linear.x, self._now())

    def _on_imu(self, message: Imu) -> None:
        if message.linear_acceleration_covariance[0] == -1.0:  # it measures none (REP-145)
            return
        with self._lock:
            if self._bridge is not None:
                self._bridge.set_force(message.linear_acceleration.x, self._now())

    def _log_throttled(self, text: str) -> None:
        self.get_logger().warning(text, throttle_duration_sec=1.0)

    # ---- operator ----

    async def _on_arm(
        self, request: SetBool.Request, response: SetBool.Response
    ) -> SetBool.Response:
        self._arm_when_ready = False
        bridge = self._bridge
        if bridge is None:
            response.success, response.message = False, "not armed: the bridge is not configured"
        elif request.data:
            executor = self.executor
            outcome: Future = Future(executor=executor)

            def answer(found: ArmingOutcome) -> None:
                outcome.set_result(found)
                executor.wake()  # it comes from another thread, and this one would wait on

            with self._lock:
                self._step()  # what has arrived decides, also before the I/O thread has its turn
                bridge.arm(self._now(), answer)
                self._step()
            response.success, response.message = await outcome
        else:
            with self._lock:
                response.success, response.message = bridge.disarm(self._now())
                self._step()
        return response

    def _on_release(
        self, _request: Trigger.Request, response: Trigger.Response
    ) -> Trigger.Response:
        if self._bridge is None:
            response.success, response.message = False, "the bridge is not configured"
        else:
            with self._lock:
                response.success, response.message = self._bridge.release(self._now())
                self._step()
        return response

    def _on_emergency_stop(
        self, _request: Trigger.Request, response: Trigger.Response
    ) -> Trigger.Response:
        self._arm_when_ready = False
        if self._bridge is None:
            response.success, response.message = False, "the bridge is not configured"
        else:
            with self._lock:
                response.success, response.message = self._bridge.emergency_stop(self._now())
                self._step()
        return response


def _change_state(
    change: Callable[[ChangeState.Request, ChangeState.Response], ChangeState.Response],
    request: ChangeState.Request,
    response: ChangeState.Response,
) -> ChangeState.Response:
    """Refuse a transition that does not begin in this state; rclpy's own callback raises."""
    try:
        return change(request, response)
    except RuntimeError:  # rcl has logged it
        response.success = False
        return response


def main() -> None:
    """Entry point of the executable `tricycle_bridge`."""
    run_node(BridgeNode)


if __name__ == "__main__":
    main()
