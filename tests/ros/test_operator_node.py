"""What a caller of services does where the middleware loses an answer."""

import signal
from types import SimpleNamespace

import pytest
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from nav_msgs.msg import Odometry
from rclpy.task import Future

from excitation_planner.playback import BEING_STOPPED, LONGEST_STOP
from excitation_planner.vehicle_watch import MUST_STAND
from tricycle_cli.operation import operator_node
from tricycle_cli.operation.operator_node import Operator, Patience, ServiceCaller
from tricycle_core.errors import NodeError
from tricycle_core.maneuver_state import ManeuverState, PlaybackState

pytestmark = pytest.mark.ros


class Losing:
    """A server that has found a client only when it is asked the third time; and its clients."""

    def __init__(self):
        self.asked = []

    def create_client(self, _kind, name):
        server = self

        class Client:
            srv_name = name

            def service_is_ready(self):
                return True

            def call_async(self, _request):
                server.asked.append(name)
                answer = Future()
                if len(server.asked) > 2:
                    answer.set_result(name)
                return answer

        return Client()


def test_a_request_is_made_once_when_the_node_has_answered_a_greeting(monkeypatch):
    monkeypatch.setattr(operator_node, "GREET_AGAIN", 0.0)
    node = Losing()

    def wait(condition, what):
        for _ in range(1000):
            if condition():
                return
        raise AssertionError(what)

    services = ServiceCaller(node, wait)
    assert services.call("driver/start", object, "request") == "driver/start"
    assert node.asked == [*["driver/get_parameters"] * 3, "driver/start"]
    services.call("driver/start", object, "request")  # a server that was restarted is greeted anew
    assert node.asked[4:] == ["driver/get_parameters", "driver/start"]


def test_a_start_that_comes_too_soon_is_tried_again_until_the_vehicle_rests():
    answers, slept = [BEING_STOPPED, f"the vehicle moves; {MUST_STAND}", ""], []
    operator = Operator.__new__(Operator)
    operator._patience, operator._simulated = 60.0, False
    operator._sleep = slept.append

    def trigger(service):
        if answer := answers.pop(0):
            raise NodeError(f"{service}: {answer}")

    operator._trigger = trigger
    operator._trigger_at_rest("maneuver_driver/start")
    assert answers == []
    assert len(slept) == 2
    answers[:] = ["the vehicle is not armed"]
    with pytest.raises(NodeError, match="not armed"):
        operator._trigger_at_rest("maneuver_driver/start")


@pytest.mark.parametrize(("namespace", "where"), [("", ""), ("left", " in namespace /left")])
def test_nodes_that_do_not_run_are_waited_for_aloud_and_with_domain_and_namespace(
    ros_environment, monkeypatch, capfd, namespace, where
):
    monkeypatch.setattr(operator_node, "SILENCE_TIMEOUT", 0.3)
    monkeypatch.setattr(operator_node, "TOLD", 0.1)
    domain = int(ros_environment["ROS_DOMAIN_ID"])
    operator = Operator(domain=domain, check=lambda: None, simulated=False, namespace=namespace)
    message = f"s{where} for a publisher of vehicle/state: .* run, with ROS_DOMAIN_ID {domain}"
    with operator, pytest.raises(NodeError, match=message):
        operator.publishers("vehicle/state")
    assert "waits for a publisher of vehicle/state" in capfd.readouterr().err


def test_poses_that_nobody_publishes_are_noticed_before_a_drive(
    ros_environment, ros_node, monkeypatch
):
    monkeypatch.setattr(operator_node, "SILENCE_TIMEOUT", 5.0)
    ros_node.create_publisher(Odometry, "/a/odom", 1)
    ros_node.create_subscription(Odometry, "/heard", lambda _: None, 1)
    domain = int(ros_environment["ROS_DOMAIN_ID"])
    with Operator(domain=domain, check=lambda: None, simulated=False) as operator:
        operator.wait_for_poses("odom")
        operator.wait_for_poses("/a/odom")
        monkeypatch.setattr(operator_node, "SILENCE_TIMEOUT", 0.3)
        for topic in ("/odom", "heard"):
            with pytest.raises(NodeError, match=f"a publisher of poses on {topic}: .* --pose"):
                operator.wait_for_poses(topic)


def test_a_countdown_is_followed_however_long_the_state_says_the_same():
    said = [PlaybackState.STARTING] * 60 + [PlaybackState.RUNNING, PlaybackState.DONE]
    operator = Operator.__new__(Operator)
    operator._state, operator._heard, operator._taught = ManeuverState(said[0], "mine"), 0, ""

    def wait(condition, what):
        for _ in range(2):  # within the patience
            if condition():
                return
            operator._on_state(status(ManeuverState(said.pop(0), "mine").values()))
        assert condition(), what

    operator._wait = wait
    operator._follow(SimpleNamespace(id="mine"), lambda *_: None, early=False)
    assert said == []


@pytest.mark.parametrize("early", [False, True])
def test_only_a_drive_that_may_end_early_is_ended_by_what_the_monitor_says(early):
    operator, called = Operator.__new__(Operator), []
    operator._state, operator._heard = ManeuverState(PlaybackState.RUNNING, "mine"), 0
    estimates = {"known": "true", "plan_id": "mine"}
    operator._on_estimates(status(estimates))

    def wait(condition, what):
        if not condition():
            operator._on_state(status(ManeuverState(PlaybackState.DONE, "mine").values()))
        assert condition(), what

    def call(service, *_):
        called.append(service)
        operator._on_state(status(ManeuverState(PlaybackState.DONE, "mine").values()))

    operator._wait, operator._services = wait, SimpleNamespace(call=call)
    operator._follow(SimpleNamespace(id="mine"), lambda *_: None, early=early)
    assert called == (["maneuver_driver/finish"] if early else [])


@pytest.mark.parametrize(
    ("ends", "failure"),
    [
        (ManeuverState(PlaybackState.WAITING, "mine", elapsed=31.4), None),
        (ManeuverState(PlaybackState.WAITING, "mine"), "way back aborted: .* started anew"),
        (ManeuverState(PlaybackState.WAITING), "way back aborted: .* started anew"),
        (ManeuverState(PlaybackState.ABORTED, "mine", reason="fence"), "way back aborted: fence"),
    ],
)
def test_a_driver_that_is_started_anew_on_the_way_back_has_not_arrived(ends, failure):
    said = [ManeuverState(PlaybackState.RETURNING, "mine", elapsed=t) for t in (0.0, 0.5)]
    interrupted = Interrupted()
    operator = interrupted.operator
    operator._state = ManeuverState(PlaybackState.DONE, "mine")
    operator._heard, operator._wait = 0, waiting(operator, [*said, ends])
    if failure is None:
        operator._go_back()
    else:
        with pytest.raises(NodeError, match=failure):
            operator._go_back()


@pytest.mark.parametrize("plan", ["", "mine"])  # before and after the driver has taken it again
def test_a_driver_that_is_started_anew_ends_the_drive(plan):
    operator = Operator.__new__(Operator)
    operator._state, operator._heard = ManeuverState(PlaybackState.RUNNING, "mine"), 0
    operator._wait = waiting(operator, [ManeuverState(PlaybackState.WAITING, plan)])
    with pytest.raises(NodeError, match=r"maneuver aborted: .* started anew"):
        operator._follow(SimpleNamespace(id="mine"), lambda *_: None, early=False)


def waiting(operator, said):
    """A wait in which an operator hears states of the driver."""

    def wait(condition, what):
        while not condition():
            assert said, what
            operator._on_state(status(said.pop(0).values()))

    return wait


def status(values):
    return DiagnosticStatus(values=[KeyValue(key=k, value=v) for k, v in values.items()])


CALLED = ["recorder/start", "driver/start", "driver/abort", "recorder/stop"]


class Interrupted:
    """An operator that gets a signal, or None, each time that it waits."""

    def __init__(self, *numbers):
        self.numbers, self.called, self.slept = list(numbers), [], []
        self.rests = False  # after a run that is over: the driver refuses to abort
        operator = self.operator = Operator.__new__(Operator)
        operator._held, operator._deaf = None, False
        operator._simulated, operator._patience = False, 60.0
        operator._check = lambda: None
        operator._executor = SimpleNamespace(spin_once=self.spin)
        operator._services = SimpleNamespace(call=self.call)
        operator._set_parameters = lambda *_, **__: None
        operator._sleep = self.sleep
        logger = SimpleNamespace(warning=lambda _: None)
        operator._node = SimpleNamespace(get_logger=lambda: logger)

    def spin(self, **_):
        if self.numbers and (number := self.numbers.pop(0)):
            signal.raise_signal(number)

    def call(self, service, *_):
        self.operator._spin()
        self.called.append(service.rpartition("_")[2])
        success = service != "maneuver_driver/abort" or not self.rests
        return SimpleNamespace(success=success, message="")

    def sleep(self, duration):
        self.operator._spin()
        self.slept.append(duration)

    def drive(self):
        with self.operator._recording("bag"), self.operator._driving():
            self.operator._trigger("maneuver_driver/start")
            self.operator._spin()


@pytest.fixture
def _ending_signals_interrupt():
    numbers = signal.SIGTERM, signal.SIGHUP
    before = [signal.signal(number, signal.default_int_handler) for number in numbers]
    yield
    for number, handler in zip(numbers, before, strict=True):
        signal.signal(number, handler)


@pytest.mark.usefixtures("_ending_signals_interrupt")
@pytest.mark.parametrize("second", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_second_signal_cancels_neither_the_abort_nor_what_is_recorded_of_it(second):
    interrupted = Interrupted(None, None, signal.SIGINT, second)
    with pytest.raises(KeyboardInterrupt):
        interrupted.drive()
    assert interrupted.called == CALLED
    assert interrupted.slept == [LONGEST_STOP]


@pytest.mark.usefixtures("_ending_signals_interrupt")
@pytest.mark.parametrize("rests", [False, True])
def test_a_signal_while_the_vehicle_rolls_out_stops_it(rests):
    interrupted = Interrupted(None, None, None, signal.SIGINT)
    interrupted.rests = rests
    interrupted.operator._state = ManeuverState(PlaybackState.DONE, "mine")
    with pytest.raises(KeyboardInterrupt):
        interrupted.drive()
    assert interrupted.called == CALLED
    assert interrupted.slept == ([] if rests else [LONGEST_STOP])


@pytest.mark.usefixtures("_ending_signals_interrupt")
@pytest.mark.parametrize("second", [None, signal.SIGTERM])
def test_a_signal_while_the_bag_is_closed_stops_what_rolls_and_waits_for_the_bag(second):
    interrupted = Interrupted(None, None, None, None, signal.SIGINT, second)
    with pytest.raises(KeyboardInterrupt):
        interrupted.drive()
    assert interrupted.called == CALLED


@pytest.mark.usefixtures("_ending_signals_interrupt")
def test_a_signal_while_the_recorder_starts_ends_the_recording():
    interrupted = Interrupted(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt):
        interrupted.drive()
    assert interrupted.called == ["recorder/start", "driver/abort", "recorder/stop"]


@pytest.mark.parametrize(
    ("answer", "called"),
    [("already recording another: stop it first", []), (None, ["recorder/stop"])],
)
def test_only_a_recording_that_was_not_refused_is_stopped(answer, called):
    interrupted = Interrupted()

    def start(service, *_):
        interrupted.operator._services.call = interrupted.call
        if answer is None:
            raise NodeError(f"waited 20 s for an answer of {service}")
        return SimpleNamespace(success=False, message=answer)

    interrupted.operator._services.call = start
    with pytest.raises(NodeError, match=answer or "an answer of trajectory_recorder/start"):
        interrupted.drive()
    assert interrupted.called == called


@pytest.mark.usefixtures("_ending_signals_interrupt")
def test_a_third_signal_ends_what_is_recorded_of_a_stopped_vehicle():
    interrupted = Interrupted(None, None, *[signal.SIGINT] * 4)
    with pytest.raises(KeyboardInterrupt):
        interrupted.drive()
    assert (interrupted.called, interrupted.slept) == (CALLED, [])


def test_a_slow_simulation_is_waited_for_while_its_clock_goes_on(monkeypatch):
    wall, simulated = [100.0], [7.0]
    monkeypatch.setattr(operator_node, "time", SimpleNamespace(monotonic=lambda: wall[0]))
    slow, none = Patience(20.0, lambda: simulated[0]), Patience(20.0, None)

    def go_on(seconds, factor):
        for _ in range(seconds):
            wall[0] += 1.0
            simulated[0] += factor
            slow.over  # noqa: B018  (it is asked again and again)

    go_on(19, 0.05)
    assert not none.over
    go_on(2, 0.05)
    assert none.over
    go_on(370, 0.05)
    assert not slow.over
    go_on(10, 0.05)  # 20 s of its time
    assert slow.over
    slow = Patience(20.0, lambda: simulated[0])
    go_on(100, 0.05)
    go_on(19, 0.0)
    assert not slow.over
    go_on(2, 0.0)  # its clock stands
    assert slow.over
