"""Fit of a fleet with parameters that all vehicles share, and evidence of the drives alone.

Letters of shapes: `v` vehicles of n variables each, of which s are common to all and m are not.
"""

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from parameter_identification.estimation.arrow import Arrow
from parameter_identification.estimation.estimates import estimates_of, identifiable
from parameter_identification.estimation.interval_correction import (
    MIN_DRIVES_FOR_SCATTER,
    beyond_ranges,
    few_drives_factors,
    pulled_parameters,
    scatter_factors,
    with_prior_variance,
)
from parameter_identification.estimation.intervals import half_width
from parameter_identification.estimation.population import Population, population
from parameter_identification.estimation.results import Estimate
from parameter_identification.vehicle_fit import (
    VehicleCost,
    VehicleFit,
    descend,
)
from parameter_identification.vehicle_scatter import VehicleScatter, scatter_of
from parameter_identification.workers import Steps
from tricycle_core.quantities import FloatArray

TAKEN_OUT = 0.999  # share of a rate's prior: what is left keeps a single drive's rate finite


@dataclass(eq=False)
class FleetFit:
    """Vehicles of which some variables are the same in all.

    Attributes
    ----------
    fits : sequence of VehicleFit
        The vehicles, each at its own best fit.
    common : sequence of int
        Places of these variables.
    """

    fits: Sequence[VehicleFit]
    common: Sequence[int]

    def descend(self, executor: Executor | None, steps: Steps | None = None) -> None:
        """Bring all vehicles to the best fit of all drives together.

        Parameters
        ----------
        executor : concurrent.futures.Executor, optional
            Default: this process.
        steps : Steps, optional
            As of `vehicle_fit.descend`.

        Raises
        ------
        IdentificationError
            If there is no minimum.
        """
        common = list(self.common)
        if not common:
            return
        points = np.array([fit.at for fit in self.fits])
        points[:, common] = np.median(points[:, common], axis=0)
        low, high = self._bounds()
        points += self._arrow(points).step(low - points, high - points)
        for fit, point in zip(self.fits, points, strict=True):
            fit.at = point
        descend([self], executor, ["all vehicles together"], steps=steps)

    def trial(self, length: float) -> tuple[list[FloatArray], float]:
        """Return the point (n,) of each vehicle after a step, and the decrease of the cost by it.

        Parameters
        ----------
        length : float
            Share of the step that is made.
        """
        points, (low, high) = np.array([fit.at for fit in self.fits]), self._bounds()
        arrow = self._arrow(points)
        step = length * arrow.step(low - points, high - points)
        return list(np.clip(points + step, low, high)), arrow.decrease(step)

    def total(self, costs: Sequence[VehicleCost]) -> float:
        """Return the cost of all vehicles, in which the prior of what is common counts once.

        Parameters
        ----------
        costs : sequence of VehicleCost
            Cost of each vehicle, with the prior.
        """
        off = (costs[0].at - self.fits[0].variables.mean)[list(self.common)]
        return sum(cost.cost for cost in costs) - float(off @ self._repeated() @ off)

    def _bounds(self) -> tuple[FloatArray, FloatArray]:
        """Bounds (v, n) of the variables."""
        low = np.array([fit.variables.low for fit in self.fits])
        return low, np.array([fit.variables.high for fit in self.fits])

    def _prior(self) -> FloatArray:
        """Prior information (s, s) of what is common."""
        places = np.array(self.common, dtype=np.int64)
        return self.fits[0].variables.information[np.ix_(places, places)]

    def _repeated(self) -> FloatArray:
        """Prior information (s, s) that the fits count too often: once for each but one."""
        return (len(self.fits) - 1) * self._prior()

    def _arrow(self, points: FloatArray) -> Arrow:
        """Cost of all vehicles near points (v, n), by their derivatives close by."""
        sums, mean = [fit.quadratic for fit in self.fits], self.fits[0].variables.mean
        shifted = [
            s.gradient + s.information @ (point - s.at)
            for s, point in zip(sums, points, strict=True)
        ]
        repeated, common = self._repeated(), np.array(self.common, dtype=np.int64)
        return Arrow(
            np.array([s.information for s in sums]),
            np.array(shifted),
            common,
            -repeated,
            -repeated @ (points[0] - mean)[common],
        )

    def posterior(self, level: float) -> "FleetPosterior":
        """Return the distribution of the variables at the best fit.

        Parameters
        ----------
        level : float
            Probability of the intervals.
        """
        points = np.array([fit.at for fit in self.fits])
        arrow = self._arrow(points)
        covariance, own_covariance, sensitivity = arrow.covariances()
        beyond = np.zeros(len(self.common), dtype=bool)
        if self.common:
            prior = self._prior()
            # few vehicles do not show how they scatter; their drives may
            clusters = list(arrow.gradient[:, np.newaxis])
            if len(clusters) < MIN_DRIVES_FOR_SCATTER:
                clusters = [fit.quadratic.slopes for fit in self.fits]
            slopes = np.concatenate(
                [
                    own[:, arrow.common] + own[:, arrow.own] @ f
                    for own, f in zip(clusters, sensitivity, strict=True)
                ]
            )
            if len(slopes) < MIN_DRIVES_FOR_SCATTER:
                factors = self._factors_of_few(level)
            else:
                _, factors = scatter_factors(covariance, slopes, prior, level)
            covariance = covariance * np.outer(factors, factors)
            variables, free = self.fits[0].variables, np.full_like(points, np.inf)
            beyond = beyond_ranges(
                points[0, arrow.common],
                (points + arrow.step(-free, free))[0, arrow.common],
                np.sqrt(np.diag(covariance)),
                variables.low[arrow.common],
                variables.high[arrow.common],
            )
            covariance = with_prior_variance(covariance, np.asarray(np.linalg.inv(prior)), beyond)
        return FleetPosterior(
            fits=self.fits,
            at=points,
            common=arrow.common,
            own=arrow.own,
            shared_covariance=covariance,
            own_covariance=own_covariance,
            sensitivity=sensitivity,
            beyond=beyond,
            scatters=[scatter_of(fit, level) for fit in self.fits],
        )

    def _factors_of_few(self, level: float) -> FloatArray:
        """Factors (s,) for what is common, where all vehicles together have few drives."""
        k = len(self.fits[0].setting.vehicle.unknown)
        vehicles = []
        for fit in self.fits:
            before = fit.variables.information.copy()
            before[k:] = 0.0
            vehicles.append(fit.quadratic.with_prior(fit.variables.mean, -before))
        _, factors = few_drives_factors(vehicles, k, np.ones(k), level, without=None)
        return factors[list(self.common)]


@dataclass(frozen=True, eq=False)
class FleetPosterior:
    """Best fit of the vehicles and covariance of their variables, in the parts that `Arrow` gives.

    Attributes
    ----------
    fits : sequence of VehicleFit
        The vehicles.
    at : ndarray of float, shape (v, n)
        Their variables.
    common, own : ndarray of int, shape (s,) and (m,)
        Places of the variables that are the same in all, and of the others.
    shared_covariance : ndarray of float, shape (s, s)
        Covariance of the common variables.
    own_covariance : ndarray of float, shape (v, m, m)
        Covariance of the other variables of each vehicle, if the common ones were known.
    sensitivity : ndarray of float, shape (v, m, s)
        Derivatives of the best other variables by the common ones.
    beyond : ndarray of bool, shape (s,)
        True for common variables that all drives together pull beyond their ranges.
    scatters : sequence of VehicleScatter
        How the drives of each vehicle scatter, over the deviations by its drives alone. `result_of`
        compares with what all vehicles leave of these: a shared parameter is known better.
    """

    fits: Sequence[VehicleFit]
    at: FloatArray
    common: NDArray[np.int64]
    own: NDArray[np.int64]
    shared_covariance: FloatArray
    own_covariance: FloatArray
    sensitivity: FloatArray
    beyond: NDArray[np.bool_]
    scatters: Sequence[VehicleScatter]

    def covariance(self, i: int) -> FloatArray:
        """Return the covariance (n, n) of the variables of a vehicle.

        Parameters
        ----------
        i : int
            Number of the vehicle.
        """
        found = np.empty((self.at.shape[1], self.at.shape[1]))
        sensitivity = self.sensitivity[i]
        found[np.ix_(self.common, self.common)] = self.shared_covariance
        found[np.ix_(self.own, self.common)] = sensitivity @ self.shared_covariance
        found[np.ix_(self.common, self.own)] = (sensitivity @ self.shared_covariance).T
        found[np.ix_(self.own, self.own)] = (
            self.own_covariance[i] + sensitivity @ self.shared_covariance @ sensitivity.T
        )
        return found

    def shared(self, level: float) -> dict[str, Estimate]:
        """Return the estimates of the common parameters, by name.

        Parameters
        ----------
        level : float
            Probability of the intervals.
        """
        vehicle = self.fits[0].setting.vehicle
        return estimates_of(
            vehicle,
            self.at[0, self.common],
            np.sqrt(np.diag(self.shared_covariance)),
            level,
            beyond=self.beyond,
            names=[list(vehicle.unknown)[i] for i in self.common],
        )

    def pulled(self, i: int) -> tuple[str, ...]:
        """Return which of its own parameters the drives of a vehicle pull beyond their ranges.

        Parameters
        ----------
        i : int
            Number of the vehicle.
        """
        fit = self.fits[i]
        names, bounds = list(fit.setting.vehicle.unknown), fit.variables
        factors = self.scatters[i].factors[: len(names)]
        beyond = pulled_parameters(fit.at, fit.quadratic, factors, bounds.low, bounds.high)
        return tuple(name for j, name in enumerate(names) if beyond[j] and j not in self.common)

    def without_prior(self, at: Sequence[int]) -> "DriveEvidence":
        """Return the evidence of the drives alone of a level of each vehicle, and perhaps its rate.

        The prior would otherwise count for every vehicle. A vehicle that is held at the end of a
        range shows none of them: what it is held by, its other parameters make up for.

        Parameters
        ----------
        at : sequence of int
            Places of the variables.
        """
        variables = self.fits[0].variables
        prior = np.diag(variables.information)[list(at)].copy()
        prior[1:] *= TAKEN_OUT
        places = np.searchsorted(self.own, at)
        estimates, covariances, common_errors, shown = [], [], [], []
        root = np.linalg.cholesky(self.shared_covariance)
        for i in range(len(self.fits)):
            whole = np.linalg.inv(self.covariance(i)[np.ix_(at, at)])
            narrowed = identifiable(whole[0, 0] ** -0.5)
            shown.append(bool(narrowed and not self.pulled(i) and self.fits[i].converged))
            if not shown[-1]:  # without the prior nothing may be left
                continue
            with_prior = np.linalg.inv(self.own_covariance[i][np.ix_(places, places)])
            covariance = np.linalg.inv(with_prior - np.diag(prior))
            factors = self.scatters[i].factors[list(at)]
            rhs = with_prior @ self.at[i, at] - prior * variables.mean[list(at)]
            estimates.append(covariance @ rhs)
            covariances.append(covariance * np.outer(factors, factors))
            common_errors.append(covariance @ with_prior @ self.sensitivity[i][places] @ root)
        v, q, e = len(estimates), len(at), len(self.common)
        return DriveEvidence(
            np.reshape(estimates, (v, q)),
            np.reshape(covariances, (v, q, q)),
            np.reshape(common_errors, (v, q, e)),
            shown,
        )


@dataclass(frozen=True, eq=False)
class DriveEvidence:
    """Level and perhaps rate, q variables in ranges, by the drives alone, without their prior.

    They are those of the v vehicles whose drives show the level.

    Attributes
    ----------
    estimates : ndarray of float, shape (v, q)
        Estimates of the variables for each vehicle.
    covariances : ndarray of float, shape (v, q, q)
        Covariance of each vehicle's estimates, if what all vehicles share were known.
    common_errors : ndarray of float, shape (v, q, e)
        Their change by one standard deviation of each of e errors that they have in common.
    shown : sequence of bool
        For each vehicle of the fleet, whether its drives show the level.
    """

    estimates: FloatArray
    covariances: FloatArray
    common_errors: FloatArray
    shown: Sequence[bool]

    def population(
        self, vehicles: Sequence[str], i: int, scale: tuple[float, float], level: float
    ) -> Population:
        """Return the population of one of the variables.

        Parameters
        ----------
        vehicles : sequence of str
            Names of those that show it.
        i : int
            Number of the variable.
        scale : (float, float)
            Value at 0 and that of one more, in the unit of the population.
        level : float
            Probability of the intervals.
        """
        start, width = scale
        return population(
            vehicles,
            start + width * self.estimates[:, i],
            width * np.sqrt(self.covariances[:, i, i]),
            common_errors=width * self.common_errors[:, i],
            level=level,
        )

    def with_rates(self, rates: Population, width: float, level: float) -> "DriveEvidence":
        """Return the levels alone, with what the population tells of rates that are not odd.

        Parameters
        ----------
        rates : Population
            Population of the rates.
        width : float
            Value of a rate of 1 in the unit of `rates`.
        level : float
            Probability of the intervals.
        """
        spread = rates.spread.middle / width
        wide = (rates.mean.high - rates.mean.low) / (2.0 * half_width(level)) / width
        rate = self.covariances[:, 1, 1]
        slope = self.covariances[:, 0, 1] / rate
        odd = np.array([m.odd for m in rates.members])
        kept = np.where(odd, 1.0, spread**2 / (spread**2 + rate))
        found = np.array([m.value.middle for m in rates.members]) / width
        value = self.estimates[:, 0] + slope * (found - self.estimates[:, 1])
        variance = (
            self.covariances[:, 0, 0] - slope * self.covariances[:, 0, 1] + slope**2 * kept * rate
        )
        more = (slope * (1.0 - kept))[:, None]
        common_errors = self.common_errors[:, 0] - more * self.common_errors[:, 1]
        common_errors = np.column_stack([common_errors, more * wide])
        return DriveEvidence(
            value[:, None], variance[:, None, None], common_errors[:, None], self.shown
        )
