"""Set-points with which the nominal vehicle follows what was measured."""

import numpy as np
import pytest
from simulated_drives import TRUTH, VEHICLE, commands_of_pair

from parameter_identification.drives.following import (
    servo_angle,
    servo_response,
    setpoints_for_steering,
    speed_followed,
)
from parameter_identification.drives.samples import Samples
from tricycle_core.timing import TICK
from tricycle_sim.vehicle.batch import simulate

STEP = 1.0 / 435  # rad, of the board's ADC
COMMANDS = commands_of_pair()["lane"]
SLOW = VEHICLE.replace(servo_natural_frequency=0.5 * VEHICLE.servo_natural_frequency)


def test_the_servo_is_the_simulations():
    motion = simulate(VEHICLE, COMMANDS, TRUTH[None])
    angle = servo_angle(COMMANDS, motion.time[:-1], VEHICLE)
    np.testing.assert_allclose(angle, motion.steering_motor_angle[0, :-1], atol=1e-12)


@pytest.mark.parametrize(("step", "error"), [(1e-6, 1e-4), (STEP, 7e-4)])
def test_the_nominal_servo_reaches_the_angle_of_another_one(step, error):
    time = TICK * np.arange(int(COMMANDS.duration / TICK))
    true = servo_angle(COMMANDS, time, SLOW)
    told = Samples(time, step * np.round(true / step))
    commanded, wanted = setpoints_for_steering(COMMANDS, told, VEHICLE)
    own, reached = (servo_response(s, VEHICLE)[: len(time)] for s in (commanded, wanted))
    assert np.std(own - true) > 4e-3
    assert np.std(reached - true) < error


def test_a_servo_as_in_the_file_needs_no_others_set_points():
    time = TICK * np.arange(int(COMMANDS.duration / TICK))
    true = servo_angle(COMMANDS, time, VEHICLE)
    told = Samples(time, STEP * np.round(true / STEP))
    commanded, wanted = setpoints_for_steering(COMMANDS, told, VEHICLE)
    assert np.std(wanted - commanded) < 0.5 * STEP


def test_the_nominal_vehicle_has_the_speed():
    time = TICK * np.arange(400)
    speed = 1.0 + 0.2 * np.sin(time)
    commands = speed_followed(VEHICLE, 0.1 + 0.0 * time, speed)
    motion = simulate(VEHICLE, commands, speed=speed[0], setpoint=speed[0])
    np.testing.assert_allclose(motion.vx[0, 100:399], speed[100:399], atol=2e-3)
