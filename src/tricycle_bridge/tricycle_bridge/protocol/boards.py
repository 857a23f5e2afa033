"""Constants of the two boards: sensors, actuators and thresholds that no message can change.

Emulation and firmware use the same values: `tricycle_bridge.protocol.firmware_header` writes
them into the firmware's C header. The limits that a host meets (angle, rate, speed, acceleration,
watchdog) are in `tricycle_bridge.protocol.limits`.
"""

import math

# Supplies: the drive PLC measures the battery, the steer PLC the servo's regulator behind it.
DRIVE_SUPPLY = 48.0  # V
STEER_SUPPLY = 12.0  # V

# Inputs.
ADC_REFERENCE = 5.0  # V of ...
ADC_FULL = 1023  # ... so many counts
ADC_CENTRE = 512  # counts of the potentiometer at 0 rad
ADC_SCALE = 435  # counts per rad of the steering motor
ADC_LOW = 5  # counts; less is a broken wire
ADC_HIGH = 1018  # counts; more is a broken wire
PULSES_PER_TURN = 138  # of the hub motor: 23 pole pairs x 6 edges
TYRE_RADIUS = 0.335  # m
HALL_PULSE = 0.015253  # m of travel per hall pulse on a wheel of that radius
LINE_LOW = (0.5, 1.5)  # V of a hall line at low level ...
LINE_HIGH = (3.5, 4.5)  # V ... and at high level; anything else is a broken or shorted wire ...
LINE_TICKS = 3  # ... when it lasts for so many ticks: HALL_LINE
LINE_RESTING = (1.0, 4.0)  # V of a whole line at low and high level
LINE_OPEN = 5.0  # V of a broken one: the board's pull-up
SUPPLY_DIVIDER = 11  # of the divider between a supply and its input

# Outputs.
SERVO_CENTRE = 1500  # us pulse at 0 rad
SERVO_SPAN = 500  # us more at the end stop
PWM_TOP = 799  # timer count of full PWM: 16 MHz / 800 = 20 kHz

# State machine (section 5 of docs/protocol.md).
HOLDING_TIME = 10.0  # s for which a steer PLC holds its angle after it was armed
TRACKING_ERROR = 0.15  # rad between set-point and angle ...
TRACKING_TIME = 1.0  # s ... for so long: TRACKING
AT_REST = 0.02  # m/s; less counts as measured speed 0
STOPPING_TIME = 8.0  # s after which a drive PLC in STOPPING gives up: STOP_TIMEOUT
STOPPING_DECELERATION = 1.2  # m/s^2 of the ramp in STOPPING at least, whatever SETUP says
STOPPING_EXCESS = 0.2  # m/s above the ramp in STOPPING at which the friction brake joins ...
STOPPING_BRAKE_RATE = 0.05  # ... and grows per tick, as a share of the full brake
OVERSPEED_MARGIN = 0.48  # m/s above the largest speed; more is OVERSPEED
OVERSHOOT = 0.2  # m/s above what is wanted to which an armed motor may push, or by what the ...
OVERSHOOT_TIME = 0.32  # s ... last so many seconds, as the time constant of a lag, have gained ...
RUNAWAY_MARGIN = 0.22  # m/s ... and what the vehicle may gain against it; more is OVERSPEED
HARDWARE_WATCHDOG = 0.06  # s without a tick until the microcontroller resets

# The motor that the firmware controls, whatever SETUP says.
MOTOR_NO_LOAD_SPEED = 15.5  # rad/s
MOTOR_SLOPE = 9.0  # N m s/rad, torque lost per speed near it
SPEED_GAIN = 20.0  # N m s/rad, and N m/rad of the integral

# What the wheel must do under the motor's torque (PULSES, section 5.8).
MASS_LOW = 40.0  # kg at the tread, wheels' inertia included, unless SETUP says so ...
MASS_HIGH = 100.0  # ... and at most
RESISTANCE = 0.62  # m/s^2 either way: 5 % of slope, rolling
TORQUE_LAG = 0.03  # s of the motor behind its demand
PULSE_MARGIN = 1.15  # pulses by which travel and pulses may differ
AGAINST_GEAR = 0.4  # m/s against the gear; more is the direction wire
NO_PULSE_SPEED = 0.1  # m/s of set-point at which pulses must come ...
NO_PULSE_TIME = 2.5  # s ... after so long, whatever the slope
DOUBT_PULSES = 2.0  # pulses that the set-points ask for without one, until a wheel at rest ...
RESTING_TIME = 2.0  # s ... is believed only after the brake has held it for so long

# What SETUP may say of the vehicle: lowest and highest.
HALL_PULSES = (0.001, 0.06)  # m
TYRE_RADII = (0.02, 1.0)  # m
MASSES = (1.0, 6000.0)  # kg
MAX_THROTTLE = 5.0  # V


def hall_pulse(tyre_radius: float) -> float:
    """Return the travel per hall pulse [m], in the protocol's unit.

    Parameters
    ----------
    tyre_radius : float
        Radius of the driven wheel [m].

    Examples
    --------
    >>> hall_pulse(TYRE_RADIUS)
    0.015253
    """
    return round(2.0 * math.pi * tyre_radius / PULSES_PER_TURN, 6)
