"""The driver on a vehicle's computer, whose clock is set while a maneuver runs."""

import time

import numpy as np
import pytest
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.time import Time

from excitation_planner.localisation import PlanarState
from excitation_planner.maneuver_driver_node import ManeuverDriver
from excitation_planner.playback import PlaybackState
from excitation_planner.schedule import Schedule
from tricycle_core.readiness import Readiness

pytestmark = pytest.mark.ros

PATIENCE = 30.0  # s; only a failing test waits that long
SET_BACK = 0.15  # s: less than the boards' watchdog needs to stop the vehicle


def test_a_clock_that_is_set_back_ends_the_run_at_once(ros_environment):
    rclpy.init()
    driver = ManeuverDriver()
    executor = SingleThreadedExecutor()
    executor.add_node(driver)
    playback, clock = driver._playback, driver.get_clock()

    def spin_while(state):
        deadline = time.monotonic() + PATIENCE
        while playback.state is state:
            assert time.monotonic() < deadline
            now = driver._now()
            playback.observe(PlanarState(0.0, 0.0, 0.0, 0.0), now, now)
            playback.hear(Readiness(armed=True), now)
            executor.spin_once(timeout_sec=0.1)

    try:
        playback.load(Schedule(np.array([0.0, 60.0]), np.zeros(2), np.zeros(2)))
        playback.parts.add_path(np.array([[0.0, 0.0], [1.0, 0.0]]))
        playback.parts.add_area({"ground": ("", ())})
        now = driver._now()
        playback.observe(PlanarState(0.0, 0.0, 0.0, 0.0), now, now)
        playback.hear(Readiness(armed=True), now)
        playback.start(now)
        spin_while(PlaybackState.STARTING)
        assert playback.state is PlaybackState.RUNNING
        # stands for a computer's clock that was set back, and has not caught up yet
        set_back = round((playback._ticked_at - SET_BACK) * 1e9)
        clock._set_ros_time_is_active(True)
        clock.set_ros_time_override(Time(nanoseconds=set_back, clock_type=clock.clock_type))
        spin_while(PlaybackState.RUNNING)
    finally:
        executor.shutdown()
        driver.destroy_node()
        rclpy.shutdown()
    assert playback.state is PlaybackState.ABORTED
    assert playback.reason.startswith("the clock jumped back by 0.15 s")
