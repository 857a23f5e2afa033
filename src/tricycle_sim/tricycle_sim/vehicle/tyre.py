"""The tyre: vertical load, relaxed slips, rolling resistance, and the law of its horizontal force.

`LAWS` lists the laws. A law is one function, compiled into the wheel's equations, and the constants
that it reads. A vehicle file chooses one under `parts: {tyre: NAME}`.
"""

import math

import numpy as np

from tricycle_core.quantities import FloatArray
from tricycle_sim.vehicle.approximations import arctan_positive, sine
from tricycle_sim.vehicle.laws import Constant, Law, between, inlined, not_negative, positive
from tricycle_sim.vehicle.layout import LANES, Formulas, numbered

CONSTANTS: tuple[Constant, ...] = (
    positive("cornering_stiffness", "N/rad", per_wheel=True),
    not_negative("camber_stiffness", "N/rad", per_wheel=True),
    not_negative("self_aligning_stiffness", "N m/rad", per_wheel=True),
    not_negative("rolling_coefficient_1", "1", per_wheel=True),
    not_negative("rolling_coefficient_2", "s^2/m^2", per_wheel=True),
    positive("vertical_stiffness", "N/m", per_wheel=True),
    not_negative("vertical_damping", "N s/m", per_wheel=True),
    positive("friction_coefficient", "1", per_wheel=True),
    # 0: stiffness per wheel, 1: per load
    between("load_sensitivity", "1", 0.0, 1.0, per_wheel=True),
    positive("slip_stiffness", "N", per_wheel=True),  # longitudinal, per unit slip
    positive("longitudinal_relaxation_length", "m", per_wheel=True),
    positive("lateral_relaxation_length", "m", per_wheel=True),
    positive("slip_speed_floor", "m/s", per_wheel=True),
    positive("carcass_damping_speed", "m/s", per_wheel=True),  # the damping fades out above it
    not_negative("longitudinal_carcass_damping", "N s/m", per_wheel=True),
    not_negative("lateral_carcass_damping", "N s/m", per_wheel=True),
    positive("rolling_smoothing_speed", "m/s", per_wheel=True),
)
"""Constants that every law reads: slopes at the origin and friction limit are the same for all."""

TYRE: Formulas = {
    "vertical_stiffness": lambda v: v.vertical_stiffness,
    "vertical_damping": lambda v: v.vertical_damping,
    "radius": lambda v: v.tyre_radius,
    "inverse_sigma_x": lambda v: 1.0 / v.longitudinal_relaxation_length,
    "inverse_sigma_y": lambda v: 1.0 / v.lateral_relaxation_length,
    "speed_floor_squared": lambda v: v.slip_speed_floor**2,
    "inverse_speed_floor": lambda v: 1.0 / v.slip_speed_floor,
    "rolling_1": lambda v: v.rolling_coefficient_1,
    "rolling_2": lambda v: v.rolling_coefficient_2,
    "rolling_smoothing_squared": lambda v: v.rolling_smoothing_speed**2,
}
"""Rows of every tyre, whatever its law."""
_C = numbered(TYRE, step=LANES)

LINEAR: Formulas = {
    "c_kappa": lambda v: v.slip_stiffness,
    "c_alpha": lambda v: v.cornering_stiffness,
    "c_gamma": lambda v: v.camber_stiffness,
    "aligning": lambda v: v.self_aligning_stiffness,
    "friction": lambda v: v.friction_coefficient,
    "stiffness_unloaded": lambda v: 1.0 - v.load_sensitivity,
    "stiffness_per_load": lambda v: v.load_sensitivity / v.mean_load,
    "damping_speed_squared": lambda v: v.carcass_damping_speed**2,
    "damping_x": lambda v: v.longitudinal_carcass_damping,
    "damping_y": lambda v: v.lateral_carcass_damping,
}
_L = numbered(LINEAR, step=LANES)


@inlined
def vertical_load(
    g: FloatArray, c: int, radius: float, inverse_cosine: float, rise: float
) -> float:
    """Return the load of a wheel [N].

    Parameters
    ----------
    g : ndarray of float, shape (rows * LANES,)
        Group of vehicles, as in `layout`.
    c : int
        Index in `g` at which the tyre's constants of the vehicle begin.
    radius : float
        Loaded radius [m].
    inverse_cosine : float
        Inverse of the cosine of the lean angle.
    rise : float
        Vertical speed of the contact point as carried by the hub [m/s].
    """
    deflection = (g[c + _C.radius] - radius) * inverse_cosine
    load: float = max(
        0.0, g[c + _C.vertical_stiffness] * deflection - g[c + _C.vertical_damping] * rise
    )
    return load


@inlined
def slip_slopes(
    g: FloatArray,
    c: int,
    vx: float,
    slip_speed: float,
    vy: float,
    kappa: float,
    alpha: float,
    stiffer: float,
) -> tuple[float, float]:
    """Return the slopes of both relaxed slips [1/s].

    Slips that count more relax more slowly: those of a viscous contact in a time, not on a length.

    Parameters
    ----------
    g : ndarray of float, shape (rows * LANES,)
        Group of vehicles, as in `layout`.
    c : int
        Index in `g` at which the tyre's constants of the vehicle begin.
    vx : float
        Forward speed of the contact point [m/s].
    slip_speed, vy : float
        Speed of the contact point over the road, forward and to the left [m/s].
    kappa, alpha : float
        Relaxed slips, longitudinal and lateral.
    stiffer : float
        Factor by which the law counts both slips more, by speed.
    """
    speed = math.sqrt(vx * vx + g[c + _C.speed_floor_squared]) / stiffer
    return (
        -(slip_speed + speed * kappa) * g[c + _C.inverse_sigma_x],
        -(vy + speed * alpha) * g[c + _C.inverse_sigma_y],
    )


@inlined
def trail_side(g: FloatArray, c: int, vx: float) -> float:
    """Return the factor of the aligning moment by the direction of rolling, -1 to 1.

    The force acts behind the middle of the contact, as the wheel rolls: backwards that is in front.

    Parameters
    ----------
    g : ndarray of float, shape (rows * LANES,)
        Group of vehicles, as in `layout`.
    c : int
        Index in `g` at which the tyre's constants of the vehicle begin.
    vx : float
        Forward speed of the contact point [m/s].
    """
    share = max(-1.0, min(1.0, vx * g[c + _C.inverse_speed_floor]))
    # with two continuous derivatives, for the order of the integration
    square = share * share
    side: float = 0.125 * share * (15.0 - square * (10.0 - 3.0 * square))
    return side


@inlined
def rolling_resistance(g: FloatArray, c: int, radius: float, load: float, rolling: float) -> float:
    """Return the moment about the axle against the spin [N m].

    Parameters
    ----------
    g : ndarray of float, shape (rows * LANES,)
        Group of vehicles, as in `layout`.
    c : int
        Index in `g` at which the tyre's constants of the vehicle begin.
    radius : float
        Loaded radius [m].
    load : float
        Load of the wheel [N].
    rolling : float
        Loaded radius times spin [m/s].
    """
    rolling2 = rolling * rolling
    moment: float = (
        radius
        * load
        * (g[c + _C.rolling_1] + g[c + _C.rolling_2] * rolling2)
        * rolling
        / math.sqrt(rolling2 + g[c + _C.rolling_smoothing_squared])
    )
    return moment


@inlined
def unlimited(
    g: FloatArray,
    c: int,
    load: float,
    kappa: float,
    alpha: float,
    lean: float,
    vx: float,
    slip_speed: float,
    vy: float,
) -> tuple[float, float]:
    """Return the forces that a tyre would have without a friction limit, forward and left [N].

    Parameters
    ----------
    g : ndarray of float, shape (rows * LANES,)
        Group of vehicles, as in `layout`.
    c : int
        Index in `g` at which the law's constants of the vehicle begin.
    load : float
        Load of the wheel [N].
    kappa, alpha : float
        Relaxed slips, longitudinal and lateral.
    lean : float
        Lean angle of the wheel [rad], positive with the top to the left.
    vx, slip_speed, vy : float
        As for `slip_slopes`.
    """
    fade_speed = g[c + _L.damping_speed_squared]
    fade = fade_speed / (vx * vx + fade_speed)
    x0 = g[c + _L.c_kappa] * kappa - g[c + _L.damping_x] * fade * slip_speed
    stiffness = g[c + _L.stiffness_unloaded] + g[c + _L.stiffness_per_load] * load
    y0 = (
        stiffness * (g[c + _L.c_alpha] * alpha + g[c + _L.c_gamma] * lean)
        - g[c + _L.damping_y] * fade * vy
    )
    return x0, y0


@inlined
def linear(
    g: FloatArray,
    c: int,
    load: float,
    kappa: float,
    alpha: float,
    lean: float,
    vx: float,
    slip_speed: float,
    vy: float,
) -> tuple[float, float, float, float, float]:
    """Return forces linear in the slips, limited by a friction circle.

    Parameters
    ----------
    g : ndarray of float, shape (rows * LANES,)
        Group of vehicles, as in `layout`.
    c : int
        Index in `g` at which the law's constants of the vehicle begin.
    load : float
        Load of the wheel [N].
    kappa, alpha : float
        Relaxed slips, longitudinal and lateral.
    lean : float
        Lean angle of the wheel [rad], positive with the top to the left.
    vx, slip_speed, vy : float
        As for `slip_slopes`.

    Returns
    -------
    force_x, force_y : float
        Force on the tyre, forward and to the left [N].
    aligning : float
        Moment about the vertical while the wheel rolls forwards [N m].
    friction_squared : float
        Square of the force after limiting over the friction limit's: at most 1.
    stiffer : float
        Factor of both slips by speed, for `slip_slopes`.
    """
    x0, y0 = unlimited(g, c, load, kappa, alpha, lean, vx, slip_speed, vy)
    limit = g[c + _L.friction] * load
    limit2 = limit * limit
    force2 = x0 * x0 + y0 * y0
    inverse = 1.0 / math.sqrt(math.sqrt(limit2 * limit2 + force2 * force2 + 1e-12))
    grip = limit * inverse
    return grip * x0, grip * y0, -g[c + _L.aligning] * alpha * grip, force2 * inverse * inverse, 1.0


@inlined
def fiala(
    g: FloatArray,
    c: int,
    load: float,
    kappa: float,
    alpha: float,
    lean: float,
    vx: float,
    slip_speed: float,
    vy: float,
) -> tuple[float, float, float, float, float]:
    """Return the forces of a brush tyre with a parabolic pressure: it slides from behind.

    Parameters
    ----------
    g : ndarray of float, shape (rows * LANES,)
        Group of vehicles, as in `layout`.
    c : int
        Index in `g` at which the law's constants of the vehicle begin.
    load, kappa, alpha, lean, vx, slip_speed, vy : float
        As for `linear`.

    Returns
    -------
    force_x, force_y, aligning, friction_squared, stiffer : float
        As of `linear`.
    """
    x0, y0 = unlimited(g, c, load, kappa, alpha, lean, vx, slip_speed, vy)
    slides = max(3.0 * g[c + _L.friction] * load, 1e-12)
    theta = math.sqrt(x0 * x0 + y0 * y0) / slides  # 1: the whole contact slides
    sliding = min(theta, 1.0)
    grip = (1.0 - sliding + sliding * sliding / 3.0) / max(theta, 1.0)
    adhering = (1.0 - sliding) * (1.0 - sliding) * (1.0 - sliding)
    friction_squared = (1.0 - adhering) * (1.0 - adhering)
    return grip * x0, grip * y0, -g[c + _L.aligning] * alpha * adhering, friction_squared, 1.0


SOFTENED: Formulas = {
    **LINEAR,
    "brush": lambda v: np.minimum(v.tyre_saturation, 1.0),
    "brush_friction": lambda v: v.friction_coefficient / np.maximum(v.tyre_saturation, 1.0),
    "rounding": lambda v: v.tyre_rounding,
    "by_speed": lambda v: v.slip_by_speed,
    "speed_floor_squared": lambda v: v.slip_speed_floor**2,
    "as_lateral": lambda v: (
        1.0 + v.slip_by_speed * (v.cornering_stiffness / v.slip_stiffness - 1.0)
    ),
}
_S = numbered(SOFTENED, step=LANES)


@inlined
def softened(
    g: FloatArray,
    c: int,
    load: float,
    kappa: float,
    alpha: float,
    lean: float,
    vx: float,
    slip_speed: float,
    vy: float,
) -> tuple[float, float, float, float, float]:
    """Return a mixture of the forces of `linear` (saturation 0) and of `fiala` (1).

    Above 1 the tyre is a brush tyre whose friction is divided by the saturation. With a rounding of
    1 the force of `linear` bends earlier: its limiter is of second order instead of fourth. A tyre
    of the magic formula lies between. Slip by speed makes the force grow with the speed at the same
    slip, and as stiff lengthwise as across, up to a viscous contact, as wheels of MuJoCo and of ODE
    (Gazebo) have.

    Parameters
    ----------
    g : ndarray of float, shape (rows * LANES,)
        Group of vehicles, as in `layout`.
    c : int
        Index in `g` at which the law's constants of the vehicle begin.
    load, kappa, alpha, lean, vx, slip_speed, vy : float
        As for `linear`.

    Returns
    -------
    force_x, force_y, aligning, friction_squared, stiffer : float
        As of `linear`.
    """
    speed = math.sqrt(vx * vx + g[c + _S.speed_floor_squared])
    stiffer = 1.0 + g[c + _S.by_speed] * (speed - 1.0)
    kappa *= g[c + _S.as_lateral]
    x0, y0 = unlimited(g, c, load, kappa, alpha, lean, vx, slip_speed, vy)
    limit = g[c + _S.friction] * load
    limit2 = limit * limit
    force2 = x0 * x0 + y0 * y0
    inverse = 1.0 / math.sqrt(math.sqrt(limit2 * limit2 + force2 * force2 + 1e-12))
    slides = max(3.0 * g[c + _S.brush_friction] * load, 1e-12)
    theta = math.sqrt(force2) / slides  # 1: the whole contact of the brush tyre slides
    sliding = min(theta, 1.0)
    adhering = (1.0 - sliding) * (1.0 - sliding) * (1.0 - sliding)
    brush, rest = g[c + _S.brush], 1.0 - g[c + _S.brush]
    rounded = 1.0 / math.sqrt(limit2 + force2 + 1e-12)
    circle = rest * limit * (inverse + g[c + _S.rounding] * (rounded - inverse))
    grip = circle + brush * (1.0 - sliding + sliding * sliding / 3.0) / max(theta, 1.0)
    slid = 1.0 - adhering
    friction_squared = rest * force2 * inverse * inverse + brush * slid * slid
    aligning = -g[c + _S.aligning] * alpha * (circle + brush * adhering)
    return grip * x0, grip * y0, aligning, friction_squared, stiffer


MAGIC_FORMULA: Formulas = {
    **LINEAR,
    "shape_x": lambda v: v.shape_longitudinal,
    "curvature_x": lambda v: v.curvature_longitudinal,
    "shape_y": lambda v: v.shape_lateral,
    "curvature_y": lambda v: v.curvature_lateral,
    "inverse_mean_load": lambda v: 1.0 / v.mean_load,
    "friction_load_slope": lambda v: v.friction_load_slope,
}
_F = numbered(MAGIC_FORMULA, step=LANES)


@inlined
def _shape(s: float, c: float, e: float) -> float:
    """Return the force over its limit at a slip s that is normalised to slope and limit 1."""
    argument = s / c
    return sine(c * arctan_positive(argument - e * (argument - arctan_positive(argument))))


@inlined
def magic_formula(
    g: FloatArray,
    c: int,
    load: float,
    kappa: float,
    alpha: float,
    lean: float,
    vx: float,
    slip_speed: float,
    vy: float,
) -> tuple[float, float, float, float, float]:
    """Return the forces by Pacejka's formula, combined by the similarity of both directions.

    Parameters
    ----------
    g : ndarray of float, shape (rows * LANES,)
        Group of vehicles, as in `layout`.
    c : int
        Index in `g` at which the law's constants of the vehicle begin.
    load, kappa, alpha, lean, vx, slip_speed, vy : float
        As for `linear`.

    Returns
    -------
    force_x, force_y, aligning, friction_squared, stiffer : float
        As of `linear`.
    """
    x0, y0 = unlimited(g, c, load, kappa, alpha, lean, vx, slip_speed, vy)
    excess = load * g[c + _F.inverse_mean_load] - 1.0
    friction = g[c + _F.friction] * max(0.1, 1.0 - g[c + _F.friction_load_slope] * excess)
    limit = friction * load
    inverse = 1.0 / max(limit, 1e-9)
    sx, sy = x0 * inverse, y0 * inverse
    s2 = sx * sx + sy * sy + 1e-24
    s = math.sqrt(s2)
    px = _shape(s, g[c + _F.shape_x], g[c + _F.curvature_x])
    py = _shape(s, g[c + _F.shape_y], g[c + _F.curvature_y])
    force = (sx * sx * px + sy * sy * py) / s2
    grip = limit * force / s
    aligning = -g[c + _F.aligning] * alpha * py / s
    return grip * sx, grip * sy, aligning, force * force, 1.0


LAWS = {
    "linear": Law(linear, LINEAR),
    "fiala": Law(fiala, LINEAR),
    "softened": Law(
        softened,
        SOFTENED,
        # 0: linear up to the friction limit, 1: as `fiala`
        (
            between("tyre_saturation", "1", 0.0, 4.0, default=0.0, per_wheel=True),
            # order of the limiter, 0: fourth, 1: second
            between("tyre_rounding", "1", 0.0, 1.0, default=0.0, per_wheel=True),
            # 0: forces by slip, 1: by the speed of the slip, alike in all directions, with the same
            # cornering stiffness at 1 m/s
            between("slip_by_speed", "1", 0.0, 1.0, default=0.0, per_wheel=True),
        ),
    ),
    "magic_formula": Law(
        magic_formula,
        MAGIC_FORMULA,
        (
            between("shape_longitudinal", "1", 0.5, 2.0, per_wheel=True),
            Constant("curvature_longitudinal", "1", low=-100.0, high=1.0, per_wheel=True),
            between("shape_lateral", "1", 0.5, 2.0, per_wheel=True),
            Constant("curvature_lateral", "1", low=-100.0, high=1.0, per_wheel=True),
            # of the friction coefficient, by load over the mean load of the wheels
            between("friction_load_slope", "1", 0.0, 1.0, default=0.0, per_wheel=True),
        ),
    ),
}
"""Every law by name; the first is the default."""
