"""Common part of all nodes: running one, declaring its parameters, offering its topics.

A node ends quickly and silently, with one line for a user's mistake.
"""

from __future__ import annotations

import contextlib
import copy
import gc
import json
import logging
import re
import signal
import sys
from collections.abc import Callable, Iterator
from functools import partial
from importlib.resources import files
from types import FrameType
from typing import Any

import rclpy
import rclpy.logging
from builtin_interfaces.msg import Time
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.callback_groups import CallbackGroup
from rclpy.exceptions import (
    InvalidParameterTypeException,
    InvalidParameterValueException,
    ParameterException,
)
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.signals import SignalHandlerOptions
from rclpy.subscription import Subscription
from rclpy.utilities import remove_ros_args
from rosgraph_msgs.msg import Clock

from tricycle_core import __version__
from tricycle_core.errors import did_you_mean, message_of
from tricycle_core.namesakes import full_name
from tricycle_core.stamps import split_seconds
from tricycle_core.start import ending_signals

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""Quality of service of topics whose newest message reaches who subscribes later."""

RECORDED = QoSProfile(depth=1000)
"""Quality of service of what comes at every tick: nothing is lost by a recorder that is held up.

For 10 s at 100 Hz, or for a second of a simulation at ten times real time.
"""

_ENDING: list[int] = []  # signals that told the process to end
# not an Event: a second signal, while the first one's handler holds the Event's lock, would wait
# for ever

_MISTAKES = (
    ValueError,
    OSError,
    RuntimeError,  # a quality of service that does not exist
    ParameterException,
    InvalidParameterTypeException,
    InvalidParameterValueException,
)


_WRONG_TYPE = re.compile(r"Trying to set parameter '(.*?)' to '(.*)' of type .* type '(\w+)'")
_OUT_OF_RANGE = re.compile(
    r"Parameter (\S+) out of range\.? Min: (\S+), Max: (\S+), value: ([^:]+):"
)
_KINDS = {
    "BOOL": "true or false",
    "INTEGER": "a whole number",
    "DOUBLE": "a number with a point, as 2.0",
    "STRING": "a text",
    "STRING_ARRAY": "a list of texts, as [a, b]",
    "DOUBLE_ARRAY": "a list of numbers with a point, as [0.0, 2.0]",
}
"""Kind of value that a parameter needs, by rclpy's name of its type."""


class NotTheExecutors(CallbackGroup):
    """Hides subscriptions and their event handlers from the executor: the node polls them."""

    def can_execute(self, _entity: object) -> bool:
        """Return False."""
        return False

    def beginning_execution(self, _entity: object) -> bool:
        """Return False."""
        return False

    def ending_execution(self, _entity: object) -> None:
        """Do nothing."""


def take_waiting(subscription: Subscription, most: int) -> Iterator[tuple[Any, dict[str, int]]]:
    """Take the messages that wait in the queue of a subscription.

    Parameters
    ----------
    subscription : rclpy.subscription.Subscription
        Subscription; it need not be the executor's.
    most : int
        Number of messages after which the others are left.

    Yields
    ------
    message : object
        Message; serialised, as bytes, where the subscription is raw.
    info : dict of str to int
        What the middleware says of it, as `received_timestamp` [ns].
    """
    with subscription.handle:
        for _ in range(most):
            taken = subscription.handle.take_message(subscription.msg_type, subscription.raw)
            if taken is None:
                return
            yield taken


def time_message(seconds: float) -> Time:
    """Return a stamp for a message.

    Parameters
    ----------
    seconds : float
        Time [s].
    """
    sec, nanosec = split_seconds(seconds)
    return Time(sec=sec, nanosec=nanosec)


def overridable(qos: QoSProfile | int) -> dict[str, Any]:
    """Arguments of a publisher or subscription whose quality of service a user can override.

    History, depth and reliability become read-only parameters, named for example
    `qos_overrides./odom.subscription.depth`.

    Parameters
    ----------
    qos : QoSProfile or int
        Default profile, or its depth; it is copied, because rclpy changes the one it is given.
    """
    profile = QoSProfile(depth=qos) if isinstance(qos, int) else copy.copy(qos)
    options = QoSOverridingOptions.with_default_policies()
    return {"qos_profile": profile, "qos_overriding_options": options}


def publisher_names(node: Node, topic: str) -> list[str]:
    """Return the full names of the nodes that publish on a topic, one for each publisher.

    Parameters
    ----------
    node : Node
        Node that asks; its namespace and remappings count.
    topic : str
        Name of the topic.
    """
    ends = node.get_publishers_info_by_topic(node.resolve_topic_name(topic))
    return [full_name(end.node_namespace, end.node_name) for end in ends]


def declare(
    node: Node,
    name: str,
    default: Any,
    description: str,
    span: tuple[float, float] | None = None,
    *,
    read_only: bool = True,
    constraints: str = "",
) -> Any:
    """Declare a parameter and return its value.

    Parameters
    ----------
    node : Node
        Node that has the parameter.
    name : str
        Name of the parameter.
    default : bool, int, float, str, list of float or list of str
        Value unless set; it decides the type.
    description : str
        Description shown by `ros2 param describe`, with the unit.
    span : (float, float), optional
        Smallest and largest value of a number.
    read_only : bool
        Whether it can be set only when the node starts.
    constraints : str
        When it can be set, where that is neither at the start only nor at any time.
    """
    descriptor = ParameterDescriptor(
        description=description, read_only=read_only, additional_constraints=constraints
    )
    if span is not None and isinstance(default, int):
        low, high = map(int, span)
        descriptor.integer_range = [IntegerRange(from_value=low, to_value=high)]
    elif span is not None:
        descriptor.floating_point_range = [
            FloatingPointRange(from_value=float(span[0]), to_value=float(span[1]))
        ]
    return node.declare_parameter(name, default, descriptor).value


def ignore_impossible_times(node: Node) -> None:
    """Ignore messages of /clock with a negative time, on which rclpy's own callback raises.

    Parameters
    ----------
    node : Node
        Node; nothing is done unless it uses simulated time.
    """
    for subscription in node.subscriptions:
        if subscription.msg_type is Clock and subscription.callback:
            subscription.callback = partial(_set_possible_time, subscription.callback)


def _set_possible_time(set_time: Callable[[Clock], None], message: Clock) -> None:
    if message.clock.sec >= 0:
        set_time(message)


def _documented() -> dict[str, tuple[str, list[list[str]]]]:
    """Names and parameters of the nodes by their classes, as `make reference` has found them."""
    document: dict[str, tuple[str, list[list[str]]]] = json.loads(
        (files("tricycle_core") / "nodes.json").read_text(encoding="utf-8")
    )
    return document


def _help(factory: Callable[[], Node]) -> str:
    """Return what the node is, and its parameters."""
    name, parameters = _documented()[factory.__name__]
    about = (sys.modules[factory.__module__].__doc__ or "").strip()
    lines = [f"usage: {name} [--ros-args -p NAME:=VALUE ... | --params-file FILE]", "", about, ""]
    lines.append("parameters (default; range) that can be set at the start, * also later:")
    for parameter, default, span, fixed, meaning in parameters:
        values = "; ".join(text for text in (default, span) if text)
        when = {"at start": "", "any time": " *"}.get(fixed, f" * {fixed}")
        lines += [f"  {parameter}{f' ({values})' if values else ''}{when}", f"      {meaning}"]
    return "\n".join([*lines, "", f"topics and services: ros2 node info {name}", ""])


def _check_arguments() -> None:
    """Refuse arguments that no node has; those of ROS follow `--ros-args`."""
    if others := remove_ros_args(sys.argv)[1:]:
        raise ValueError(
            f"unknown arguments: {' '.join(others)}; parameters are set by "
            "--ros-args -p NAME:=VALUE, --help lists them"
        )


def _warn_of_unknown_parameters(node: Node) -> None:
    """Say which parameters that were given are none of the node's; rclpy passes over them."""
    known = node.list_parameters([], 0).names
    for name in node._parameter_overrides:  # noqa: SLF001 - rclpy has no public access
        if not node.has_parameter(name):
            hint = did_you_mean(name, known) or "--help lists those there are"
            node.get_logger().warning(f"{name} is not a parameter of this node: {hint}")


def _told(mistake: Exception) -> str:
    """Return what is wrong, in one line."""
    if type(mistake).__name__ == "UnknownROSArgsError":  # rclpy says nothing but the list
        return f"unknown ROS arguments: {mistake}"
    text = message_of(mistake)
    if wrong := _WRONG_TYPE.match(text):
        name, value, wanted = wrong.groups()
        return f"{name}: needs {_KINDS.get(wanted, wanted)}, not {value}"
    if wrong := _OUT_OF_RANGE.search(text):
        name, low, high, value = wrong.groups()
        return f"{name} = {value} must be from {low} to {high}"
    return text


def ending() -> bool:
    """Return whether the process was told to end; for loops that wait outside the executor."""
    return bool(_ENDING)


def run_node(factory: Callable[[], Node]) -> None:
    """Construct a node, spin it until one of `ending_signals` arrives, and shut it down quietly.

    With `--help` it says what the node is, and its parameters, and starts nothing.

    Exits with status 2 and one logged line where the arguments are wrong, or constructing the node
    raises what a user's mistake raises: ValueError, OSError, a parameter of the wrong type or out
    of range. Warns of given parameters that the node does not have. A callback may end the process
    by raising SystemExit, and `destroy_node` may set its status so.

    Parameters
    ----------
    factory : callable
        Function that makes the node; called after rclpy is initialised.
    """
    if {"-h", "--help"} & set(sys.argv[1:]):
        print(_help(factory), end="")
        return
    _ENDING.clear()

    def stop(number: int, _frame: FrameType | None) -> None:
        _ENDING.append(number)

    # rclpy's own handlers sometimes print a traceback
    ends = ending_signals()
    for number in ends:
        signal.signal(number, stop)
    # messages of libraries, e.g. that the vehicle model is being compiled
    logging.basicConfig(format="[INFO] [%(name)s]: %(message)s", level=logging.INFO)
    node: Node | None = None
    executor: SingleThreadedExecutor | None = None
    try:
        try:
            rclpy.init(args=sys.argv, signal_handler_options=SignalHandlerOptions.NO)
            _check_arguments()
            executor = SingleThreadedExecutor()
            node = factory()
            _warn_of_unknown_parameters(node)
            node.get_logger().info(f"runs, version {__version__}")
            ignore_impossible_times(node)
        except _MISTAKES as mistake:
            kind = getattr(factory, "__name__", "node")
            name, _ = _documented().get(kind, (kind, []))
            rclpy.logging.get_logger(name).fatal(_told(mistake))
            raise SystemExit(2) from None
        # a collection through all that was imported would hold the node up for several ticks
        gc.freeze()
        executor.add_node(node)
        while not _ENDING:
            executor.spin_once(timeout_sec=0.1)
    finally:
        if executor is not None:
            executor.shutdown()
        ending: SystemExit | None = None  # of a node that could not end well
        if node is not None:
            try:
                node.destroy_node()
            except KeyboardInterrupt:
                pass
            except SystemExit as error:
                ending = error
        # from Kilted on this destroys nodes, one whose construction failed too
        with contextlib.suppress(AttributeError) if node is None else contextlib.nullcontext():
            rclpy.try_shutdown()
        # Ctrl-C comes twice from `ros2 launch`; Python gives up its handlers before it has ended
        for number in ends:
            signal.signal(number, signal.SIG_IGN)
        if ending is not None:
            raise ending
