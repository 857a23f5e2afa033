"""The operator of a running system: resets, arms, records and drives one plan after the other."""

import math
import sys
import time
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager, nullcontext, suppress
from pathlib import Path
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.client import Client
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future
from std_srvs.srv import SetBool, Trigger

from excitation_planner.plan import Plan
from excitation_planner.plan_publisher import PlanPublisher
from excitation_planner.playback import BEING_STOPPED, LONGEST_STOP
from excitation_planner.preflight import RECORDER
from excitation_planner.vehicle_watch import MUST_STAND
from trajectory_recorder.recording import LACKS
from tricycle_cli.operation.dashboard import DiagnosticEntry, diagnostic_entries
from tricycle_cli.operation.enough import Enough
from tricycle_cli.operation.processes import OF_VEHICLE, interrupts_held
from tricycle_core.closing import Closing
from tricycle_core.diagnostics import Level, values_of
from tricycle_core.errors import NodeError
from tricycle_core.maneuver_state import ManeuverState, PlaybackState
from tricycle_core.namesakes import UNNAMED, namesakes
from tricycle_core.nodes import LATCHED, ignore_impossible_times
from tricycle_core.quantities import Progress

STANDSTILL = 1.5  # s at rest before the start and after the end, for the judge's anchor
# of wall time and of a simulated clock, see Patience:
SERVICE_TIMEOUT = 60.0  # s for a node to appear and answer; a first start compiles
SILENCE_TIMEOUT = 20.0  # s without a word of nodes that have answered before
LINK_TIMEOUT = 30.0  # s for both PLCs to be linked, refreshed and armed
REFUSED = 0.5  # s until a start is tried again that came too soon
GREET_AGAIN = 2.0  # s without an answer until a node is greeted again
TOLD = 6.0  # s of wall time after which it says what it waits for
STARTED_ANEW = "maneuver_driver was started anew meanwhile; see why, and give the command again"
LOOK_AROUND = 10.0  # s of wall time in which the nodes of a domain are found at the latest


class Patience:
    """Longest time to wait for something, on the wall clock and on a simulation's clock.

    A simulation that runs slowly is waited for as long as its clock goes on.

    Parameters
    ----------
    seconds : float
        Time to wait on each clock [s].
    clock : callable, optional
        Returns the simulated time [s]; None: there is none.
    """

    def __init__(self, seconds: float, clock: Callable[[], float] | None) -> None:
        self._seconds, self._clock = seconds, clock
        self._begun = self._ticked = time.monotonic()
        self._start = self._newest = clock() if clock else 0.0

    @property
    def over(self) -> bool:
        """Whether it has been waited for that long."""
        now = time.monotonic()
        if self._clock is None:
            return now - self._begun > self._seconds
        if (simulated := self._clock()) != self._newest:
            self._newest, self._ticked = simulated, now
        stands = now - self._ticked > self._seconds
        waited = min(now - self._begun, simulated - self._start)
        return stands or waited > self._seconds


class ServiceCaller:
    """Calls services of other nodes, each request once, without losing the answer.

    The middleware drops an answer when the server has not found the client's reader within 100 ms,
    as happens to a new client on a busy machine. The request cannot be repeated then: it may have
    started something. So a greeting goes first, a request without effect that may be repeated.
    Readers are announced in the order in which they were made: a node that answers the greeting has
    found the client made before it.

    Parameters
    ----------
    node : Node
        Node that the clients belong to.
    wait : callable
        `wait(condition, what)` spins the node until the condition holds, or raises.
    """

    def __init__(self, node: Node, wait: Callable[[Callable[[], bool], str], None]) -> None:
        self._node = node
        self._wait = wait
        self._clients: dict[str, tuple[Client, Client]] = {}  # of the service, of the greeting

    def call(self, service: str, kind: type, request: Any) -> Any:
        """Return the answer to a request.

        Parameters
        ----------
        service : str
            Name, as `node/service`.
        kind : type
            Type of the service.
        request : object
            Request of that type.
        """
        if service not in self._clients:
            greeting = f"{service.rpartition('/')[0]}/get_parameters"
            self._clients[service] = (
                self._node.create_client(kind, service),
                self._node.create_client(GetParameters, greeting),
            )
        client, greeter = self._clients[service]
        self._wait(lambda: client.service_is_ready() and greeter.service_is_ready(), service)
        self._greet(greeter)
        answer = client.call_async(request)
        self._wait(answer.done, f"an answer of {service}")
        return answer.result()

    def _greet(self, greeter: Client) -> None:
        answers: list[Future] = []
        asked = -math.inf

        def greeted() -> bool:
            nonlocal asked
            if time.monotonic() - asked > GREET_AGAIN:
                asked = time.monotonic()
                answers.append(greeter.call_async(GetParameters.Request()))
            return any(answer.done() for answer in answers)

        self._wait(greeted, f"an answer of {greeter.srv_name}")


def refuse_company(domain: int, names: Collection[str], others: int) -> None:
    """Raise an error if nodes of a simulation to be started already run in the domain.

    Both would hear each other: a simulation would arm the vehicle.

    Parameters
    ----------
    domain : int
        ROS domain id.
    names : collection of str
        Names of the simulation's nodes.
    others : int
        Number of processes that communicate there: so many nodes are waited for.

    Raises
    ------
    NodeError
        If there are nodes of such names.
    """
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=domain, signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node("newcomer", context=context)
    end = time.monotonic() + LOOK_AROUND
    try:
        found: list[tuple[str, str]] = []
        while len(found) <= others and time.monotonic() < end:  # it is found itself
            found = [n for n in node.get_node_names_and_namespaces() if n[0] != UNNAMED]
            there = {name for name, space in found if space == "/"}
            if company := sorted(there.intersection(names)):
                raise NodeError(_company(domain, company))
            time.sleep(0.05)
    finally:
        node.destroy_node()
        rclpy.try_shutdown(context=context)


def _company(domain: int, names: Sequence[str]) -> str:
    return (
        f"ROS domain {domain} has a {', a '.join(names)} already, of a vehicle or another "
        "simulation: unset ROS_DOMAIN_ID or choose another one; a vehicle's nodes are used with "
        "--vehicle-nodes"
    )


def _accepted(service: str, answer: Trigger.Response) -> str:
    """Return the message of an answer, or raise what was refused."""
    if not answer.success:
        raise NodeError(f"{service}: {answer.message}")
    return str(answer.message)


class Operator(Closing):
    """A ROS node that does what the person at the vehicle would do by service calls.

    Parameters
    ----------
    domain : int
        ROS domain id.
    check : callable
        Called while waiting; raises when waiting has become pointless (a node has died).
    simulated : bool
        Whether times are those of `/clock`, and a drive begins with a reset and arming. On the
        vehicle the person there has armed it.
    namespace : str
        Namespace of the vehicle's nodes; if there is one, their clock is in it too.
    """

    def __init__(
        self,
        *,
        domain: int,
        check: Callable[[], None],
        simulated: bool = True,
        namespace: str = "",
    ) -> None:
        self._check = check
        self._simulated, self._domain = simulated, domain
        self._context = rclpy.Context()
        rclpy.init(
            context=self._context,
            domain_id=domain,
            signal_handler_options=SignalHandlerOptions.NO,
        )
        self._node = rclpy.create_node(
            "operator",
            context=self._context,
            namespace=namespace,
            cli_args=["--ros-args", "-r", "/clock:=clock"] if namespace else None,
            parameter_overrides=[Parameter("use_sim_time", value=simulated)],
        )
        ignore_impossible_times(self._node)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._plans = PlanPublisher(self._node)
        self._state = ManeuverState(PlaybackState.WAITING)
        self._heard = 0  # messages of it: during a countdown only the whole seconds differ
        self._patience = SERVICE_TIMEOUT
        self._node.create_subscription(DiagnosticStatus, "maneuver/state", self._on_state, LATCHED)
        self._preflight: dict[str, DiagnosticEntry] = {}
        self._looked = 0  # messages of it
        self._node.create_subscription(
            DiagnosticArray, "maneuver/preflight", self._on_preflight, LATCHED
        )
        self._taught = ""  # id of the plan whose drive has taught enough
        self._node.create_subscription(
            DiagnosticStatus, "identification/estimates", self._on_estimates, LATCHED
        )
        self._services = ServiceCaller(self._node, self._wait)
        self._held: list[int] | None = None  # signals that came while a bag is recorded
        self._deaf = False  # whether they wait

    def close(self) -> None:
        """Leave the ROS domain."""
        self._executor.shutdown()
        self._node.destroy_node()
        rclpy.try_shutdown(context=self._context)

    def drive(
        self,
        plan: Plan,
        bag: Path,
        *,
        progress: Progress,
        back: bool = False,
        ask: Callable[[], None] | None = None,
        enough: Enough | None = None,
    ) -> None:
        """Drive the plan to its end and record it to `bag`, with the way back before it.

        Parameters
        ----------
        plan : Plan
            Plan to drive.
        bag : Path
            New rosbag2 directory.
        progress : callable
            Called with the elapsed time and the duration [ms of ROS time].
        back : bool
            Whether the vehicle drives to the start by itself; a simulated one is not reset then.
        ask : callable, optional
            Waits for the start signal, once the driver has the plan; before anything moves.
        enough : Enough, optional
            When the drive may end before the plan does; `identification_monitor` must be running.

        Raises
        ------
        NodeError
            If a node does not answer, refuses, or aborts the maneuver; with its reason. A maneuver
            that was started is aborted then, and its bag closed.
        """
        self._patience = SERVICE_TIMEOUT
        if self._simulated and not back:
            x, y, heading = plan.start_pose or (0.0, 0.0, 0.0)
            self._set_parameters("tricycle_sim", start_x=x, start_y=y, start_heading=heading)
            self._trigger("tricycle_sim/reset")
            clock = self._node.get_clock()
            self._wait(lambda: clock.now().nanoseconds > 0, "/clock")  # for the plan's stamp
        self._taught = ""  # of an earlier drive
        if enough is not None:
            self._set_parameters(
                "identification_monitor",
                plan_file=str(enough.plan_file.absolute()),
                known_file=str(enough.known_file.absolute()) if enough.known_file else "",
                targets=",".join(enough.targets),
                tolerance=enough.tolerance,
            )
        self._hand_over(plan)
        if not self._simulated:
            self._refuse_doubled()
        if ask is not None:
            ask()
        if self._simulated:
            self._arm()
        elif ask is None:
            self._check_start(back=back)
        with self._recording(bag):
            if back:
                self._go_back()
            self._sleep(STANDSTILL)
            if self._state.plan_id != plan.id:  # a planner has published another one meanwhile
                self._hand_over(plan)
            with self._driving():
                self._trigger_at_rest("maneuver_driver/start")
                self._follow(plan, progress, early=enough is not None)
        if self._simulated:
            self._disarm()

    def preflight(self) -> dict[str, DiagnosticEntry]:
        """Return how everything stands that a start needs, as the driver sees it now.

        Raises
        ------
        NodeError
            If the driver does not say.
        """
        self._patience = SILENCE_TIMEOUT
        seen = self._looked
        # the next message may have been waiting for long: the one after it is new
        self._wait(lambda: self._looked >= seen + 2, "maneuver_driver to say how everything stands")
        return self._preflight

    def go_back(self, bag: Path) -> None:
        """Have the vehicle drive back to the start of the plan that was driven last.

        Parameters
        ----------
        bag : Path
            New rosbag2 directory.

        Raises
        ------
        NodeError
            If a node does not answer, or the driver refuses or gives up; with its reason.
        """
        self._patience = SERVICE_TIMEOUT
        if self._simulated:
            self._sleep(LONGEST_STOP - STANDSTILL)  # the drive has ended, the driver's stop has not
            self._arm()
        with self._recording(bag):
            self._go_back()
        if self._simulated:
            self._disarm()

    def pace(self, real_time_factor: float) -> None:
        """Set how fast the simulation runs.

        Parameters
        ----------
        real_time_factor : float
            Largest ratio of simulated to wall time; 0: as fast as it can.

        Raises
        ------
        NodeError
            If it does not answer.
        """
        self._patience = SERVICE_TIMEOUT
        self._set_parameters("tricycle_sim", real_time_factor=real_time_factor)

    def publishers(self, topic: str) -> set[str]:
        """Return the names of the nodes that publish a topic; waits until there is one.

        Parameters
        ----------
        topic : str
            Name of the topic.

        Raises
        ------
        NodeError
            If no node publishes it.
        """
        self._patience = SILENCE_TIMEOUT  # it runs already, or never will
        found: set[str] = set()

        def anybody() -> bool:
            ends = self._node.get_publishers_info_by_topic(topic)
            found.clear()
            found.update(end.node_name for end in ends)
            return bool(found) and UNNAMED not in found

        where = f"do the vehicle's nodes run, with ROS_DOMAIN_ID {self._domain}?"
        self._wait(anybody, f"a publisher of {topic}: {where}")
        return found

    def wait_for_poses(self, topic: str) -> None:
        """Wait until a node publishes the poses that a bag is to be read by.

        Parameters
        ----------
        topic : str
            Name or end of the name, as in `TopicNames`.

        Raises
        ------
        NodeError
            If no node does.
        """
        self._patience = SILENCE_TIMEOUT  # it runs already, or never will

        def published() -> bool:
            known = [name for name, _ in self._node.get_topic_names_and_types()]
            alike = [name for name in known if name == topic or name.endswith(f"/{topic}")]
            return any(self._node.count_publishers(name) for name in alike)

        self._wait(published, f"a publisher of poses on {topic}: name their topic with --pose")

    def parameters(self, node: str, names: Sequence[str]) -> dict[str, Any]:
        """Return parameters of a node by name; one that is not set is missing.

        Parameters
        ----------
        node : str
            Name of the node.
        names : sequence of str
            Names of the parameters.

        Raises
        ------
        NodeError
            If it does not answer.
        """
        self._patience = SERVICE_TIMEOUT
        request = GetParameters.Request(names=names)
        answer = self._services.call(f"{node}/get_parameters", GetParameters, request)
        return {
            name: parameter_value_to_python(value)
            for name, value in zip(names, answer.values, strict=False)
        }

    def _hand_over(self, plan: Plan) -> None:
        self._plans.publish(plan)

        def taken() -> bool:
            if self._state.state.driving:
                raise NodeError(
                    f"maneuver_driver is driving plan {self._state.plan_id}: wait for its end, "
                    "or abort it (service maneuver_driver/abort)"
                )
            return self._state.state is PlaybackState.WAITING and self._state.plan_id == plan.id

        self._wait(taken, "maneuver_driver to take the plan")
        # what the middleware sends again may come seconds later: after the start
        self._wait(self._plans.received, "every subscriber of maneuver/* to take the plan")

    def _refuse_doubled(self) -> None:
        """Refuse to drive where a node of the vehicle runs twice: either may answer and act."""
        space = self._node.get_namespace()
        found = self._node.get_node_names_and_namespaces()
        if doubled := namesakes(n for n, its in found if its == space and n in OF_VEHICLE):
            raise NodeError(f"ROS domain {self._domain}: {doubled}")

    def _check_start(self, *, back: bool) -> None:
        """Refuse what the driver would refuse, before there is a bag of it."""
        # the recorder records then, and the driver waits until the vehicle rests
        later = {RECORDER, "standstill", *(["start"] if back else [])}
        for name, item in self.preflight().items():
            if item.level is Level.ERROR and name not in later:
                raise NodeError(f"maneuver_driver/start: {item.message}")

    def _go_back(self) -> None:
        with self._driving():
            self._sleep(STANDSTILL)  # until the driver has heard that a bag is recorded
            self._trigger_at_rest("maneuver_driver/go_back")
            begun = (PlaybackState.RETURNING, PlaybackState.ABORTED)
            self._wait(lambda: self._state.state in begun, "the way back to begin")
            before = self._state
            while self._state.state is PlaybackState.RETURNING:
                before = self._state
                self._wait(lambda: self._state != before, "news of the way back")  # noqa: B023
            if self._state.state is PlaybackState.ABORTED:
                raise NodeError(f"way back aborted: {self._state.reason}")
            # one that has arrived says when
            if self._state.elapsed <= before.elapsed:
                raise NodeError(f"way back aborted: {STARTED_ANEW}")

    @contextmanager
    def _driving(self) -> Iterator[None]:
        """Run the block, then stand still; have the driver abort on a failure or interruption."""
        try:
            yield
            self._sleep(STANDSTILL)  # in which the vehicle may still roll out
        except BaseException as error:
            self._check()  # where the nodes end with a dead one, nobody is left to abort
            try:
                with self._interrupts_wait():
                    answer = self._services.call(
                        "maneuver_driver/abort", Trigger, Trigger.Request()
                    )
            except NodeError as unanswered:
                raise NodeError(
                    f"{str(error) or 'interrupted'}; the maneuver may still run, for the abort: "
                    f"{unanswered}"
                ) from error
            if self._held is not None:
                self._held.clear()  # they asked for the same
            # refused where it has ended by itself: after an abort of its own the vehicle may roll
            if answer.success or self._state.state is PlaybackState.ABORTED:
                if isinstance(error, KeyboardInterrupt):
                    self._node.get_logger().warning(
                        f"interrupted: the vehicle is stopped and recorded for {LONGEST_STOP:g} s "
                        "more"
                    )
                self._sleep(LONGEST_STOP)  # the bag shows where the vehicle came to rest
            raise

    def _follow(self, plan: Plan, progress: Progress, *, early: bool) -> None:
        """Wait for the end of the maneuver started; `early` ends it once it has taught enough."""

        def taught() -> bool:  # the monitor says so to drives that have not asked for it, too
            return early and self._taught == plan.id

        self._wait(lambda: self._state.state is not PlaybackState.WAITING, "the start")
        if self._state.plan_id != plan.id:
            raise NodeError(f"maneuver_driver started another plan, {self._state.plan_id}")
        while not self._state.state.ended:
            heard = self._heard
            self._wait(
                lambda: self._heard > heard or taught(),  # noqa: B023
                "news of the running maneuver",
            )
            if taught():
                self._taught = ""
                # refused where it has ended by itself
                self._services.call("maneuver_driver/finish", Trigger, Trigger.Request())
            if self._state.state is PlaybackState.WAITING and self._state.plan_id in ("", plan.id):
                raise NodeError(f"maneuver aborted: {STARTED_ANEW}")
            if self._state.plan_id != plan.id:
                raise NodeError(
                    f"maneuver_driver took another plan, {self._state.plan_id}, before it said "
                    "how this one ended"
                )
            progress(round(1e3 * self._state.elapsed), round(1e3 * self._state.duration))
        if self._state.state is PlaybackState.ABORTED:
            raise NodeError(f"maneuver aborted: {self._state.reason}")

    @contextmanager
    def _recording(self, bag: Path) -> Iterator[None]:
        """Record the block; signals that end the command interrupt it only where it waits."""
        self._set_parameters("trajectory_recorder", output=str(bag))
        self._patience = SILENCE_TIMEOUT
        start, refused = "trajectory_recorder/start", False
        with self._interrupts_held():
            try:
                with self._interrupts_wait():  # once asked it may record
                    started = self._services.call(start, Trigger, Trigger.Request())
                refused = not started.success
                _accepted(start, started)
                yield
            except BaseException:
                if not refused:  # it may record another one's bag
                    # the first error is reported
                    with suppress(NodeError), self._interrupts_wait():
                        self._trigger("trajectory_recorder/stop")
                raise
            try:
                answer = self._trigger("trajectory_recorder/stop")
            except KeyboardInterrupt:
                # the vehicle may still roll out; where it rests, the abort is refused
                for service in ("maneuver_driver/abort", "trajectory_recorder/stop"):
                    with suppress(NodeError), self._interrupts_wait():
                        self._trigger(service)
                raise
        if LACKS in answer:
            print(f"warning: {answer}", file=sys.stderr)

    @contextmanager
    def _interrupts_held(self) -> Iterator[None]:
        """Let signals interrupt `_wait` only: a second one must not cancel what the first began."""
        with interrupts_held() as self._held:
            try:
                yield
            finally:
                self._held = None

    @contextmanager
    def _interrupts_wait(self) -> Iterator[None]:
        """Let signals that are held not interrupt `_wait` either."""
        self._deaf = True
        try:
            yield
        finally:
            self._deaf = False

    def _arm(self) -> None:
        """Ask for ARM until both PLCs are linked and hear the standstill stream."""
        names = [name for name, space in self._node.get_node_names_and_namespaces() if space == "/"]
        if names.count("tricycle_bridge") > 1:  # of a vehicle that was found late
            raise NodeError(_company(self._domain, ["tricycle_bridge"]))
        patience = self._patient(LINK_TIMEOUT)
        while True:
            answer = self._services.call("tricycle_bridge/arm", SetBool, SetBool.Request(data=True))
            if answer.success:
                return
            if patience.over:
                raise NodeError(f"tricycle_bridge: {answer.message}")
            self._sleep(0.1)

    def _disarm(self) -> None:
        self._services.call("tricycle_bridge/arm", SetBool, SetBool.Request(data=False))

    def _on_state(self, message: DiagnosticStatus) -> None:
        with suppress(ValueError):  # of another publisher
            self._state = ManeuverState.from_values(values_of(message))
            self._heard += 1

    def _on_preflight(self, message: DiagnosticArray) -> None:
        self._looked += 1
        self._preflight = diagnostic_entries(message.status, time.monotonic())

    def _on_estimates(self, message: DiagnosticStatus) -> None:
        values = values_of(message)
        if values.get("known") == "true":
            self._taught = values.get("plan_id", "")

    def _trigger(self, service: str) -> str:
        return _accepted(service, self._services.call(service, Trigger, Trigger.Request()))

    def _trigger_at_rest(self, service: str) -> None:
        """Trigger, again and again while the vehicle does not rest yet after its last run."""
        patience = self._patient(self._patience)
        while True:
            try:
                self._trigger(service)
            except NodeError as refusal:
                too_soon = any(why in str(refusal) for why in (BEING_STOPPED, MUST_STAND))
                if not too_soon or patience.over:
                    raise
            else:
                return
            self._sleep(REFUSED)

    def _set_parameters(self, node: str, **values: str | float) -> None:
        request = SetParameters.Request(
            parameters=[Parameter(k, value=v).to_parameter_msg() for k, v in values.items()]
        )
        answer = self._services.call(f"{node}/set_parameters", SetParameters, request)
        for name, result in zip(values, answer.results, strict=True):
            if not result.successful:
                raise NodeError(f"{node}: {name}: {result.reason}")

    def _patient(self, seconds: float) -> Patience:
        clock = self._node.get_clock() if self._simulated else None
        return Patience(seconds, clock and (lambda: float(clock.now().nanoseconds) * 1e-9))

    def _sleep(self, duration: float) -> None:
        """Let `duration` seconds of ROS time pass."""
        clock = self._node.get_clock()
        end = clock.now().nanoseconds + round(duration * 1e9)
        self._wait(lambda: clock.now().nanoseconds >= end, "the clock")

    def _wait(self, condition: Callable[[], bool], what: str) -> None:
        begun, patience = time.monotonic(), self._patient(self._patience)
        told = self._simulated  # what simulates says so itself
        while not condition():
            self._check()
            if not told and time.monotonic() > begun + TOLD:
                told = True
                self._node.get_logger().info(f"waits for {what}")
            if patience.over:
                space = self._node.get_namespace()
                where = "" if space == "/" else f" in namespace {space}"
                raise NodeError(f"waited {self._patience:.0f} s{where} for {what}")
            self._spin()

    def _spin(self) -> None:
        with interrupts_held() if self._held is None else nullcontext():
            self._executor.spin_once(timeout_sec=0.05)
        if self._held and not self._deaf:
            self._held.clear()
            raise KeyboardInterrupt
