"""The bridge's clock beside a computer's clock that is set."""

import random

import pytest

from tricycle_bridge.host_clock import FOLLOWED, STEP, HostClock


class Computer:
    """Two clocks that go alike; reading one takes a while, and the computer may pause then."""

    def __init__(self):
        self.now = 50.0
        self.set_by = 1e9
        self.pauses = lambda: 1e-6

    def steady(self):
        self.now += self.pauses()
        return self.now

    def ros(self):
        self.now += self.pauses()
        return self.now + self.set_by

    def clock(self):
        return HostClock(self.ros, self.steady)


@pytest.mark.parametrize("step", [3600.0, -3600.0, 0.03, 0.015, -0.015, 1.1 * STEP])
def test_a_step_is_told_once_and_stamps_follow_it(step):
    computer = Computer()
    clock = computer.clock()
    assert clock.find_step() is None
    computer.now += 1.0
    computer.set_by += step
    assert clock.find_step() == pytest.approx(step, abs=1e-5)
    computer.now += 1.0
    assert clock.find_step() is None
    assert clock.to_ros(54.0) == pytest.approx(1e9 + 54.0 + step, abs=1e-5)


@pytest.mark.parametrize(("step", "followed"), [(0.9 * STEP, True), (0.9 * FOLLOWED, False)])
def test_a_small_step_is_not_told_and_stamps_are_never_off_by_more(step, followed):
    computer = Computer()
    clock = computer.clock()
    computer.set_by += step
    assert clock.find_step() is None
    off = computer.set_by + 54.0 - clock.to_ros(54.0)
    assert off == pytest.approx(0.0 if followed else step, abs=1e-5)


def test_steps_too_small_to_follow_do_not_add_up():
    computer = Computer()
    clock = computer.clock()
    for _ in range(100):
        computer.set_by += 0.9 * FOLLOWED
        assert clock.find_step() is None
    assert abs(computer.set_by + 54.0 - clock.to_ros(54.0)) < 1.1 * FOLLOWED


def test_a_pause_at_the_start_is_no_step_and_soon_makes_no_difference():
    computer = Computer()
    computer.pauses = lambda: 0.1
    clock = computer.clock()
    computer.pauses = lambda: 1e-6
    computer.set_by += 0.05  # as if the first readings had been off by that
    assert clock.find_step() is None
    assert clock.to_ros(54.0) == pytest.approx(computer.set_by + 54.0, abs=1e-5)


def test_a_computer_that_pauses_between_its_clocks_is_no_step():
    computer = Computer()
    chance = random.Random(0)
    computer.pauses = lambda: 1e-6 if chance.random() < 0.7 else chance.expovariate(100.0)
    clock = computer.clock()
    for _ in range(2000):
        computer.now += 0.05
        assert clock.find_step() is None
    assert clock.to_ros(54.0) == pytest.approx(1e9 + 54.0, abs=2 * FOLLOWED)
    computer.set_by += 0.015
    found = [clock.find_step() for _ in range(100)]
    assert [round(step, 3) for step in found if step is not None] == [0.015]
