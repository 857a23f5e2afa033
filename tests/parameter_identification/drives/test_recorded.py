"""What a recorded drive holds."""

import numpy as np
import pytest

from parameter_identification.drives.recorded import SteeredLeadIn
from tricycle_sim.commands import Commands


@pytest.mark.slow
def test_the_steering_of_a_lead_in_takes_the_place_of_the_plan_s_until_its_end() -> None:
    planned = Commands(np.arange(5) * 0.02, np.full(5, 0.3), np.array([1.0, 2.0, 3.0, 4.0, 4.0]))
    led = SteeredLeadIn(0.05, np.array([0.01, 0.0299, 0.04]), np.array([0.1, -0.2, 0.2]))
    found = led.in_place(planned)  # a set-point is held until the next; one at 0 s is lost
    np.testing.assert_allclose(found.time, [0.0, 0.01, 0.02, 0.03, 0.04, 0.05, 0.06, 0.08])
    np.testing.assert_allclose(
        found.steering_motor_angle, [0.3, 0.1, 0.1, -0.2, 0.2, 0.3, 0.3, 0.3]
    )
    np.testing.assert_allclose(found.speed, [1.0, 1.0, 2.0, 2.0, 3.0, 3.0, 4.0, 4.0])
