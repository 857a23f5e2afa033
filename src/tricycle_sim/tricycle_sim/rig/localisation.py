"""A localisation with white noise, as it would measure the vehicle's pose."""

from dataclasses import dataclass

import numpy as np

from tricycle_sim.vehicle.live import LiveState


@dataclass(frozen=True)
class PoseNoise:
    """White noise of a localisation, standard deviations.

    Attributes
    ----------
    position : float
        Standard deviation of the position per axis [m].
    yaw : float
        Standard deviation of the heading [rad].
    speed : float
        Standard deviation of the velocity per axis [m/s].
    yaw_rate : float
        Standard deviation of the yaw rate [rad/s].
    """

    position: float = 0.01
    yaw: float = 0.002
    speed: float = 0.01
    yaw_rate: float = 0.005


@dataclass(frozen=True)
class MeasuredPose:
    """Planar pose and velocity of `base_link` in `odom`.

    Attributes
    ----------
    x, y : float
        Position [m].
    yaw : float
        Heading [rad].
    vx, vy : float
        Velocity in `base_link` [m/s].
    yaw_rate : float
        Rate of the heading [rad/s].
    """

    x: float
    y: float
    yaw: float
    vx: float
    vy: float
    yaw_rate: float


def measure_pose(state: LiveState, noise: PoseNoise, rng: np.random.Generator) -> MeasuredPose:
    """Return the pose that a localisation measures.

    Parameters
    ----------
    state : LiveState
        True state of the vehicle.
    noise : PoseNoise
        Noise of the localisation.
    rng : Generator
        Random generator of the noise; six numbers are drawn.
    """
    n = rng.standard_normal(6)
    return MeasuredPose(
        x=state.x + noise.position * n[0],
        y=state.y + noise.position * n[1],
        yaw=state.yaw + noise.yaw * n[2],
        vx=state.vx + noise.speed * n[3],
        vy=state.vy + noise.speed * n[4],
        yaw_rate=state.yaw_rate + noise.yaw_rate * n[5],
    )
