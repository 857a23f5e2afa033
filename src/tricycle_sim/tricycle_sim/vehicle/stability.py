"""How fast a vehicle's own motions are, and whether the integration's steps are short enough.

A vehicle file may hold numbers that are plausible and still too stiff for steps of 10 ms: a current
loop of a millisecond, hard tyres, hardly any mass. Such a vehicle is refused, not simulated into
nonsense.
"""

import numpy as np

from tricycle_bridge.protocol.limits import MAX_SPEED
from tricycle_core.errors import VehicleError
from tricycle_core.quantities import FloatArray
from tricycle_core.timing import TICK
from tricycle_sim.vehicle.body import BODY, PLACE
from tricycle_sim.vehicle.constants import Vehicle
from tricycle_sim.vehicle.groups import equilibrium, motor_in_the_middle, pack
from tricycle_sim.vehicle.kernel import NO_OUTPUT, NO_ROWS, functions_for
from tricycle_sim.vehicle.layout import (
    LANES,
    SLOPE,
    STATE,
    WHEEL_STATES,
    numbered,
    of_wheels,
    states_of,
)
from tricycle_sim.vehicle.parts import BLOCK, WHEEL, WHEEL_ROWS, check_steering
from tricycle_sim.vehicle.registry import tyre_name
from tricycle_sim.vehicle.tyre import LINEAR, SOFTENED, TYRE

LIMIT = 2.5
"""Largest rate times step: RK4 is stable to 2.78 for decay and to 2.83 for oscillation."""
FASTER = 0.25
"""Share by which outer wheels, and those of a speed loop that overshoots, exceed its set-point."""

# what to change, by the state that takes the largest part in a mode
_CAUSES = {
    STATE.x: "vertical_stiffness, vertical_damping, mass or inertia",
    STATE.torque: "motor_lag or the gains of the speed controller",
    STATE.spin: "slip_stiffness, rolling_smoothing_speed or the wheels' inertia",
    STATE.kappa: "longitudinal_relaxation_length or slip_stiffness",
    STATE.alpha: "lateral_relaxation_length or cornering_stiffness",
}

_B, _P, _T = numbered(BODY, first=BLOCK.body), numbered(PLACE), numbered(TYRE)
_L, _S = numbered(LINEAR), numbered(SOFTENED)  # every law has those of `LINEAR`

_checked: set[tuple[str, float]] = set()


def check_step(vehicle: Vehicle, step: float) -> None:
    """Raise unless Runge-Kutta steps are short enough for a vehicle, and its steering turns wheels.

    Parameters
    ----------
    vehicle : Vehicle
        Vehicle; its nominal values are checked.
    step : float
        Length of the steps [s].

    Raises
    ------
    VehicleError
        If the steps are too long; the message names the rate of the fastest mode and the constants
        behind it, or `steering_limit`.
    """
    key = vehicle.fingerprint, step
    if key in _checked:
        return
    check_steering(vehicle, ranges=False)  # of a file; this may be another one, by `replace`
    rate, state = fastest_mode(vehicle)
    if not rate * step < LIMIT:
        if state > STATE.spin:  # of any wheel
            state = STATE.spin + (state - STATE.spin) % WHEEL_STATES
        cause = next(_CAUSES[first] for first in sorted(_CAUSES, reverse=True) if first <= state)
        raise VehicleError(
            f"{vehicle.name}: moves at rates of up to {rate:.0f} rad/s, steps of {1e3 * step:g} ms "
            f"allow {LIMIT / step:.0f}: change {cause}"
        )
    _checked.add(key)


def lengthen_relaxation(
    groups: FloatArray, vehicle: Vehicle, speed: float, step: float = TICK
) -> None:
    """Lengthen the relaxation of samples until the steps are stable.

    Of a vehicle that `check_step` accepts, samples may be stiffer: where a fit tries both a stiffer
    tyre and a shorter relaxation, a wheel swings faster on its tyre, or the vehicle on its tyres,
    and a slip decays faster.

    Parameters
    ----------
    groups : ndarray of float, shape (b, ROWS * LANES)
        Samples; changed in place.
    vehicle : Vehicle
        Vehicle; the samples differ in its unknown parameters.
    speed : float
        Highest set-point [m/s]; wheels may be faster by the share `FASTER`, up to `MAX_SPEED`.
    step : float
        Length of the steps [s].
    """
    rows = groups.reshape(len(groups), -1, LANES)

    def of_each(row: int) -> FloatArray:
        return rows[:, of_wheels(row, WHEEL_ROWS, len(vehicle.wheels))]

    most = LIMIT / step
    stiffness, radius = of_each(WHEEL.tyre_law + _L.c_kappa), of_each(WHEEL.tyre + _T.radius)
    along, aside = (of_each(WHEEL.tyre + row) for row in (_T.inverse_sigma_x, _T.inverse_sigma_y))
    largest = most**2 * of_each(WHEEL.place + _P.inertia) / (stiffness * radius**2)
    np.minimum(along, largest, out=along)
    fastest = max(speed, min((1.0 + FASTER) * speed, MAX_SPEED), 1e-9)
    softened = [[tyre_name(wheel, vehicle.parts) == "softened"] for wheel in vehicle.wheels]
    by_speed = np.where(softened, of_each(WHEEL.tyre_law + _S.by_speed), 0.0)
    np.minimum(aside, most * (1.0 + by_speed * (fastest - 1.0)) / fastest, out=aside)
    moved = (
        rows[:, [_B.inverse_mass]]
        + rows[:, [_B.inverse_izz]] * of_each(WHEEL.place + _P.x) ** 2
        + rows[:, [_B.inverse_ixx]] * (of_each(WHEEL.place + _P.z) - radius) ** 2
    )  # by a lateral force on each wheel, at its contact
    # the squares of the rates at which it swings aside, yawing and rolling, are together
    squares = np.sum(of_each(WHEEL.tyre_law + _L.c_alpha) * aside * moved, axis=1, keepdims=True)
    aside *= np.fmin(1.0, most**2 / squares)


def fastest_mode(vehicle: Vehicle) -> tuple[float, int]:
    """Return the fastest motion of the nominal vehicle, standing and at the highest speed.

    Parameters
    ----------
    vehicle : Vehicle
        Linearised about rolling straight on.

    Returns
    -------
    rate : float
        Largest absolute value of an eigenvalue [rad/s].
    state : int
        Row of the state that takes the largest part in that mode.
    """
    return max(_fastest_at(vehicle, speed) for speed in (0.0, MAX_SPEED))


def _fastest_at(vehicle: Vehicle, speed: float) -> tuple[float, int]:
    variation = 1e-6
    states = states_of(len(vehicle.wheels))
    samples = np.tile(vehicle.nominal_point(), (2 * states, 1))
    speeds = np.full(len(samples), speed)
    groups = pack(vehicle, samples, equilibrium(vehicle), speeds)
    rows = groups.reshape(len(groups), -1, LANES)
    for state in range(states):  # central differences in neighbouring lanes
        for sample, sign in ((2 * state, 1.0), (2 * state + 1, -1.0)):
            rows[sample // LANES, state, sample % LANES] += sign * variation
    drive = np.array([[1.0, speed, 0.0]])
    advance = functions_for(vehicle).advance
    advance(groups, motor_in_the_middle(vehicle), np.zeros(1), drive, 1, 0, NO_ROWS, 1, NO_OUTPUT)
    slopes = rows[:, SLOPE : SLOPE + states].transpose(1, 0, 2).reshape(states, -1)[:, : 2 * states]
    jacobian = (slopes[:, ::2] - slopes[:, 1::2]) / (2.0 * variation)
    # not `scipy.linalg.eig`, which has both vectors: importing SciPy takes longer than all the rest
    rates, right = np.linalg.eig(jacobian)
    fastest = int(np.argmax(np.abs(rates)))
    left_rates, left = np.linalg.eig(jacobian.T)
    same = int(np.argmin(np.abs(left_rates - rates[fastest])))
    part = np.abs(left[:, same] * right[:, fastest])
    return float(np.abs(rates[fastest])), int(np.argmax(part))
