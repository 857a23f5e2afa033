"""The speed controller that stands in for the vehicle's own."""

import pytest

from tricycle_sim.vehicle import load_vehicle
from tricycle_sim.vehicle.speed_loop import SpeedLoop


@pytest.mark.parametrize("scale", [1.0, 1.05])
def test_it_starts_at_the_torque_that_there_is(scale):
    loop = SpeedLoop(load_vehicle().replace(speed_scale=scale), 3.0, 1.0, 1.02)
    assert loop.torque(1.0, 1.02) == pytest.approx(3.0)
