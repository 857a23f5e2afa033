"""Estimates of parameters in their units, of variables in ranges."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from excitation_planner.design.prior import SHOWN, UNIFORM_STD
from parameter_identification.estimation.intervals import interval
from parameter_identification.estimation.mixture import Mixture
from parameter_identification.estimation.profiles import ProfileCurve
from parameter_identification.estimation.results import Estimate, Profile, in_range
from tricycle_core.quantities import FloatArray
from tricycle_sim.vehicle import Vehicle


def identifiable(std: FloatArray) -> NDArray[np.bool_]:
    """Return for each of k parameters whether it is known to half the deviation of its range.

    What earlier drives have told counts: a prior from them is no range.

    Parameters
    ----------
    std : ndarray of float, shape (k,)
        Standard deviations after the drives, in ranges.
    """
    return np.asarray(std <= SHOWN * UNIFORM_STD)


def estimates_of(
    vehicle: Vehicle,
    at: FloatArray,
    std: FloatArray,
    level: float,
    *,
    beyond: NDArray[np.bool_],
    widening: FloatArray | None = None,
    average: Mixture | None = None,
    curves: Mapping[int, ProfileCurve] | None = None,
    rivals: Sequence[FloatArray] = (),
    names: Sequence[str] | None = None,
) -> dict[str, Estimate]:
    """Return the estimates of parameters in their units, by name.

    Parameters
    ----------
    vehicle : Vehicle
        Ranges and units of the parameters.
    at, std : ndarray of float, shape (k,)
        Estimates and their standard deviations, in ranges.
    level : float
        Probability of the intervals.
    beyond : ndarray of bool, shape (k,)
        Parameters that the data pull beyond their ranges: their intervals are the ranges, and none
        is identifiable.
    widening : ndarray of float, shape (k,), optional
        Factors on the intervals of the average. Default: 1.
    average : Mixture, optional
        Distribution over models with and without effects, whose intervals they are then.
    curves : mapping of int to ProfileCurve, optional
        Profile likelihood of some parameters, by number: its interval replaces the linear one.
    rivals : sequence of ndarray of float, shape (k,)
        Other parameters that fit as well: the intervals hold them, and none is identifiable.
    names : sequence of str, optional
        Names of the k parameters. Default: all unknown ones of the vehicle.
    """
    names = tuple(vehicle.unknown) if names is None else names
    widening = np.ones(len(names)) if widening is None else widening
    shown = identifiable(std) & ~beyond & (not rivals)
    estimates = {}
    for i, name in enumerate(names):
        limits = vehicle.unknown[name]
        start, width = limits[0], limits[1] - limits[0]
        z, deviation = float(at[i]), float(std[i])
        ends = interval(
            i, z, deviation, level,
            beyond=bool(beyond[i]), average=average, widening=float(widening[i]),
        )  # fmt: skip
        linear = in_range(limits, ends[0]), in_range(limits, ends[1])
        curve = None if curves is None else curves.get(i)
        low, high = linear if curve is None else (in_range(limits, end) for end in curve.interval)
        others = [start + width * float(rival[i]) for rival in rivals]
        estimates[name] = Estimate(
            unit=vehicle.unit(name),
            estimate=in_range(limits, z),
            standard_deviation=width * deviation,
            low=min([low, *others]),
            high=max([high, *others]),
            linear=linear,
            range=limits,
            identifiable=bool(shown[i]),
            profile=None if curve is None else Profile(start + width * curve.z, curve.rise),
        )
    return estimates
