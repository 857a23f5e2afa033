"""Runs one rclpy node as a process: quick, silent shutdown and one line for a user's mistake."""

from __future__ import annotations

import contextlib
import signal
import sys
from collections.abc import Callable
from types import FrameType

import rclpy
import rclpy.logging
from rclpy.exceptions import (
    InvalidParameterTypeException,
    InvalidParameterValueException,
    ParameterException,
)
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

_MISTAKES = (
    ValueError,
    OSError,
    ParameterException,
    InvalidParameterTypeException,
    InvalidParameterValueException,
)


def run_node(factory: Callable[[], Node]) -> None:
    """Construct a node, spin it until SIGINT or SIGTERM, and leave no trace of the ending.

    Exits with status 2 and one logged line where constructing the node raises what a user's
    mistake raises: ValueError, OSError, a parameter of the wrong type or out of range. A callback
    may end the process by raising SystemExit.

    Parameters
    ----------
    factory
        Makes the node; rclpy is initialised then.
    """
    stopped = False

    def stop(_signal: int, _frame: FrameType | None) -> None:
        nonlocal stopped
        stopped = True

    # rclpy's own handlers print a traceback now and then; see docs/link.md
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, stop)
    rclpy.init(args=sys.argv, signal_handler_options=SignalHandlerOptions.NO)
    node: Node | None = None
    executor = SingleThreadedExecutor()
    try:
        try:
            node = factory()
        except _MISTAKES as mistake:
            name = getattr(factory, "__name__", "node")
            rclpy.logging.get_logger(name).fatal(" ".join(str(mistake).split()))
            raise SystemExit(2) from None
        executor.add_node(node)
        while not stopped:
            executor.spin_once(timeout_sec=0.1)
    finally:
        executor.shutdown()
        if node is not None:
            with contextlib.suppress(KeyboardInterrupt):
                node.destroy_node()
        rclpy.try_shutdown()
