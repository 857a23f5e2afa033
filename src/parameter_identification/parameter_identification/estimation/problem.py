"""The least-squares problem of several drives, its minimisation and its noise.

A variable vector (n,) holds parameters and nuisances, as `variables` says.

All that the minimisation needs of thousands of residuals r and their Jacobian J is the matrix
[J r]ᵀ[J r] of size n + 1, to which every signal of every drive adds its part.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from excitation_planner.choice import Choice
from excitation_planner.indices.sampling import sobol_sequence
from parameter_identification.drives.measured import Sensor
from parameter_identification.estimation.deviation_sizes import DeviationSizes
from parameter_identification.estimation.levenberg_marquardt import Fit, minimum_of
from parameter_identification.estimation.model import DriveModel, Prediction
from parameter_identification.estimation.noise import (
    NoiseLevel,
    Residuals,
    SampleWeights,
    restricted_noise,
    white_level,
    whiten,
)
from parameter_identification.estimation.quadratic import Quadratic
from parameter_identification.estimation.tally import uncounted
from parameter_identification.estimation.variables import ProblemVariables
from parameter_identification.estimation.whiteness import resolution
from tricycle_core.closing import Closing
from tricycle_core.cores import usable_cores
from tricycle_core.quantities import FloatArray

CANDIDATES = 128  # points of the Sobol' sequence that are looked at for starts
STAMPS_ALIKE = 1.0  # s for which stamps err alike: the samples within count as one
OUTLYING = 3.0  # standard deviations from which samples are down-weighted by the robust loss
KEPT = 2  # points of which the predictions are kept: noise, sizes and tests look at the same one

_T = TypeVar("_T")


class Loss(Choice):
    """Cost of a residual."""

    SQUARED = "squared"  # efficient for Gaussian noise
    ROBUST = "robust"  # residuals beyond `OUTLYING` standard deviations are down-weighted


class LeastSquares(Closing):
    """Least squares over all drives.

    Parameters
    ----------
    models : sequence of DriveModel
        One per drive.
    mean : ndarray of float, shape (k,)
        Mean of the prior of the parameters, in their ranges.
    information : ndarray of float, shape (k, k)
        Inverse covariance of that prior.
    loss : Loss
        Cost of a residual.

    Attributes
    ----------
    variables : ProblemVariables
        Order and bounds of the variables.
    n, k, shared : int
        Their numbers: all, the parameters among them, and those that all drives have in common.
    low, high : ndarray of float, shape (n,)
        Their bounds.
    sizes : DeviationSizes
        How large the deviations are.
    noise : dict of Sensor to NoiseLevel
        Noise of each sensor, by which residuals are weighted; `estimate_noise` sets it.
    floors : dict of Sensor to float
        Noise that rounding makes, at least.
    samples_in_all : int
        Numbers measured.
    """

    def __init__(
        self, models: Sequence[DriveModel], mean: FloatArray, information: FloatArray, loss: Loss
    ) -> None:
        self.models, self.mean, self.information = models, mean, information
        self._robust = loss is Loss.ROBUST
        self.variables = variables = ProblemVariables(
            len(mean), [model.nuisances for model in models], models[0].shared
        )
        self.n, self.k, self.shared = variables.n, variables.k, variables.shared
        self.low, self.high = variables.low, variables.high
        self.sizes = DeviationSizes(variables)
        self.floors = self._floors()
        self.noise = {sensor: NoiseLevel(white) for sensor, white in self._white_levels().items()}
        self._samples = [
            {
                sensor: SampleWeights(_run_weights(s.values), np.zeros(len(s.time)))
                for sensor, s in model.drive.signals.items()
            }
            for model in models
        ]
        self.samples_in_all = sum(
            signal.values.size for model in models for signal in model.drive.signals.values()
        )
        self._predicted: dict[bytes, list[list[Prediction]]] = {}
        self._pool = ThreadPoolExecutor(usable_cores())

    def _floors(self) -> dict[Sensor, float]:
        """Noise that rounding makes, at least, by sensor."""
        floors: dict[Sensor, float] = {}
        for model in self.models:
            for sensor, signal in model.drive.signals.items():
                rounding = max(resolution(column) for column in signal.values.T) / math.sqrt(12.0)
                tiny = 1e-9 * (1.0 + float(np.ptp(signal.values)))
                floors[sensor] = max(floors.get(sensor, 0.0), rounding, tiny)
        return floors

    def _white_levels(self) -> dict[Sensor, float]:
        levels = dict(self.floors)
        for model in self.models:
            for sensor, signal in model.drive.signals.items():
                levels[sensor] = max(levels[sensor], white_level(signal.time, signal.values))
        return levels

    def each(self, function: Callable[..., _T], *of: Iterable[Any]) -> Iterator[_T]:
        """Call a function with items of these in threads, as `map` does, and yield what it returns.

        Parameters
        ----------
        function : callable
            Holds the interpreter for a small part of its time.
        *of : iterable
            Iterables of its arguments, one per argument.
        """
        return self._pool.map(function, *of)

    def predictions(self, v: FloatArray) -> list[list[Prediction]]:
        """Return the predictions of each drive; the last ones are kept.

        Parameters
        ----------
        v : ndarray of float, shape (n,)
            Variables.
        """
        key = v.tobytes()
        if key in self._predicted:
            return self._predicted[key]

        def predict(pair: tuple[DriveModel, NDArray[np.int64]]) -> list[Prediction]:
            model, at = pair
            return model.predict(v[: self.k], v[at[self.k :]])

        found = list(self.each(predict, zip(self.models, self.variables.of_drives, strict=True)))
        if len(self._predicted) == KEPT:
            del self._predicted[next(iter(self._predicted))]
        self._predicted[key] = found
        return found

    def quadratic(self, v: FloatArray) -> Quadratic:
        """Return the cost near variables, with the priors' part.

        Parameters
        ----------
        v : ndarray of float, shape (n,)
            Variables.
        """
        gram = self._prior_gram(v) + self._gram_of(self.predictions(v), self.noise)
        return Quadratic.of_gram(v, gram)

    def _gram_of(
        self, predictions: Sequence[Sequence[Prediction]], noise: dict[Sensor, NoiseLevel]
    ) -> FloatArray:
        """[J r]ᵀ[J r], whitened, of all drives' signals but of sensors without a noise level."""
        return sum(self._grams(predictions, noise), np.zeros((self.n + 1, self.n + 1)))

    def _grams(
        self, predictions: Sequence[Sequence[Prediction]], noise: dict[Sensor, NoiseLevel]
    ) -> Iterator[FloatArray]:
        return self.each(
            lambda predicted, samples, at: self._signals_gram(predicted, samples, at, noise),
            *(predictions, self._samples, self.variables.of_drives),
        )

    def slopes(self, v: FloatArray) -> FloatArray:
        """Return the part of each drive in the gradient, shape (d, n).

        It includes the priors of the drive's own nuisances, not those of what all have in common.

        Parameters
        ----------
        v : ndarray of float, shape (n,)
            Variables.
        """
        grams = self._grams(self.predictions(v), self.noise)
        slopes = np.array([gram[:-1, -1] for gram in grams])
        for slope, at in zip(slopes, self.variables.of_drives, strict=True):
            own = at[self.shared :]
            slope[own] += self.sizes.precision[own - self.k] * v[own]
        return slopes

    def by_each_drive(self, v: FloatArray, free: NDArray[np.bool_]) -> Iterator[Quadratic]:
        """Yield the cost of each drive near variables, without what is known of the parameters.

        Parameters
        ----------
        v : ndarray of float, shape (n,)
            Variables, near the minima.
        free : ndarray of bool, shape (n,)
            True for variables that are estimated: the parameters, and others. The cost of a drive
            is one of those that it has, the parameters first.
        """
        prior = self._prior_gram(v)
        prior[: self.k], prior[:, : self.k] = 0.0, 0.0
        for gram, at in zip(
            self._grams(self.predictions(v), self.noise), self.variables.of_drives, strict=True
        ):
            yield Quadratic.of_gram(v, gram + prior).of(at[free[at]])

    def by_the_others(
        self, v: FloatArray, free: NDArray[np.bool_]
    ) -> Iterator[tuple[FloatArray, FloatArray, Quadratic]]:
        """Yield the variables (n,) without each drive, their covariance, and the drive's own cost.

        The variables are those after one step of the free ones. The drive's own cost is that near
        `v`, of its variables only, with the priors of those that no other drive has.

        Parameters
        ----------
        v : ndarray of float, shape (n,)
            Variables, near the minimum.
        free : ndarray of bool, shape (n,)
            True for variables that are estimated.
        """
        grams, prior = list(self._grams(self.predictions(v), self.noise)), self._prior_gram(v)
        whole = sum(grams, prior)
        common = np.ix_([*range(self.shared), self.n], [*range(self.shared), self.n])
        of_common = np.array([gram[common] for gram in grams])
        for drive, (gram, at) in enumerate(zip(grams, self.variables.of_drives, strict=True)):
            own = at[self.shared :]
            # summed without this drive: a difference loses the prior where the drive tells far more
            rest = whole - gram
            rest[common] = prior[common] + np.delete(of_common, drive, axis=0).sum(axis=0)
            rest[own], rest[:, own] = prior[own], prior[:, own]
            others = Quadratic.of_gram(v, rest)
            covariance = others.covariance(free)
            of_own = np.append(own, self.n)
            gram[np.ix_(own, of_own)] += prior[np.ix_(own, of_own)]
            gram[-1, own] = gram[own, -1]
            alone = Quadratic.of_gram(v, gram).of(at)
            yield v - covariance @ others.gradient, covariance, alone

    def common_information(self) -> FloatArray:
        """Return the inverse covariance (n, n) of the priors of what all drives have in common."""
        information = self._prior_gram(np.zeros(self.n))[:-1, :-1]
        information[self.shared :] = 0.0
        return information

    def _prior_gram(self, v: FloatArray) -> FloatArray:
        k, gram = self.k, np.zeros((self.n + 1, self.n + 1))
        deviation = v[:k] - self.mean
        prior_gradient = self.information @ deviation
        gram[:k, :k] = self.information
        gram[:k, -1] = gram[-1, :k] = prior_gradient
        nuisances = v[k:]
        gram[range(k, self.n), range(k, self.n)] = self.sizes.precision
        gram[k:-1, -1] = gram[-1, k:-1] = self.sizes.precision * nuisances
        gram[-1, -1] = deviation @ prior_gradient + self.sizes.precision @ nuisances**2
        return gram

    def _signals_gram(
        self,
        predictions: Sequence[Prediction],
        samples: dict[Sensor, SampleWeights],
        at: NDArray[np.int64],
        noise: dict[Sensor, NoiseLevel],
    ) -> FloatArray:
        gram = np.zeros((self.n + 1, self.n + 1))
        place = np.append(at, self.n)
        for p in predictions:
            if p.sensor in noise:
                for channel in range(p.residual.shape[1]):
                    columns, _ = whiten(
                        _columns(p, channel), p.time, noise[p.sensor], samples[p.sensor]
                    )
                    gram[np.ix_(place, place)] += columns.T @ columns
        return gram

    def log_determinant(self, v: FloatArray) -> float:
        """Return the logarithm of the determinant of the noise's covariance, of all residuals.

        Parameters
        ----------
        v : ndarray of float, shape (n,)
            Variables.
        """
        return sum(
            len(p.residual.T)
            * whiten(p.residual[:, :1], p.time, self.noise[p.sensor], samples[p.sensor])[1]
            for found, samples in zip(self.predictions(v), self._samples, strict=True)
            for p in found
            if p.sensor in self.noise
        )

    def candidates(self, count: int, seed: int) -> list[FloatArray]:
        """Return variables (n,) to start from: the best of a Sobol' sequence and the prior's mean.

        Parameters
        ----------
        count : int
            Number of starts.
        seed : int
            Seed of the Sobol' sequence.
        """
        Z = np.vstack([self.mean, sobol_sequence(CANDIDATES - 1, self.k, seed=seed)])
        white = {sensor: level.white for sensor, level in self.noise.items()}
        misfit = sum((model.misfits(Z, white) for model in self.models), np.zeros(len(Z)))
        best = Z[np.argsort(misfit)[:count]]
        return [self.variables.beginning(z) for z in best]

    def minimise(
        self, start: FloatArray, free: NDArray[np.bool_] | None = None, *, tolerance: float = 0.01
    ) -> Fit:
        """Search for the minimum from a start, within the bounds.

        Parameters
        ----------
        start : ndarray of float, shape (n,)
            Variables.
        free : ndarray of bool, shape (n,), optional
            True for variables that may change. Default: all.
        tolerance : float
            The search ends when the next step would lower the quadratic cost by less (an interval
            is where the cost rises by some 4); that step is taken, its cost is the quadratic one.
            Where the cost is more than one per sample, so much more.
        """
        return minimum_of(
            self.quadratic,
            start,
            (self.low, self.high),
            free=np.ones(self.n, dtype=bool) if free is None else free,
            rough=self.variables.rough,
            own=np.arange(self.n) >= self.shared,
            drives=len(self.models),
            samples=self.samples_in_all,
            tolerance=tolerance,
        )

    def estimate_sizes(self, v: FloatArray) -> None:
        """Set how large the deviations are, for which their estimates at `v` are most likely.

        Parameters
        ----------
        v : ndarray of float, shape (n,)
            Variables.
        """
        if self.variables.deviations:
            self.sizes.estimate(self.quadratic(v))

    def set_weights(
        self, noise: Mapping[Sensor, NoiseLevel], sizes: Mapping[str, float], v: FloatArray
    ) -> None:
        """Weigh residuals and deviations as another fit does.

        Parameters
        ----------
        noise : mapping of Sensor to NoiseLevel
            Noise of every sensor that a drive has, and perhaps of others.
        sizes : mapping of str to float
            Sizes of the deviations, by name.
        v : ndarray of float, shape (n,)
            Variables of that fit.
        """
        self.noise = {sensor: noise[sensor] for sensor in self.noise}
        self.sizes.set(sizes)
        self.weigh(v)

    def estimate_noise(self, v: FloatArray, count: Callable[[], None] = uncounted) -> None:
        """Set the weights of the samples and the noise of each sensor from the residuals at `v`.

        Parameters
        ----------
        v : ndarray of float, shape (n,)
            Variables.
        count : callable
            Called when the noise of a sensor is known.
        """
        predictions = self.predictions(v)
        self.weigh(v)
        grams = {
            sensor: self._gram_of(predictions, {sensor: level})
            for sensor, level in self.noise.items()
        }
        whole = sum(grams.values(), self._prior_gram(v))
        # effects count as known here: they are few against the samples, and would take long
        kept = np.append(np.flatnonzero(~self.variables.of_effects), self.n)
        place = np.cumsum(np.append(~self.variables.of_effects, True)) - 1

        def estimate(sensor: Sensor) -> NoiseLevel:
            channels = [
                Residuals(
                    p.time,
                    _columns(p, channel)[:, own],
                    place[np.append(at, self.n)[own]],
                    s[sensor],
                )
                for found, s, at in zip(
                    predictions, self._samples, self.variables.of_drives, strict=True
                )
                for own in [np.append(~self.variables.of_effects[at], True)]
                for p in found
                if p.sensor is sensor
                for channel in range(p.residual.shape[1])
            ]
            rest = (whole - grams[sensor])[np.ix_(kept, kept)]
            return restricted_noise(channels, rest, self.noise[sensor], floor=self.floors[sensor])

        found = {}
        for sensor, level in zip(self.noise, self.each(estimate, self.noise), strict=True):
            found[sensor] = level
            count()
        self.noise = found

    def weigh(self, v: FloatArray) -> None:
        """Set the weights of the samples: less where stamps matter, and by the robust loss.

        Parameters
        ----------
        v : ndarray of float, shape (n,)
            Variables.
        """
        predictions = self.predictions(v)
        for drive, (found, samples) in enumerate(zip(predictions, self._samples, strict=True)):
            for p in found:
                plain = samples[p.sensor] = self._plain_weights(drive, p)
                if self._robust:
                    excess = np.maximum(1.0, self._innovations(p, plain) / OUTLYING) ** 2
                    samples[p.sensor] = SampleWeights(plain.weights / excess, plain.stamps * excess)

    def _plain_weights(self, drive: int, p: Prediction) -> SampleWeights:
        """Weights of samples that are rounded and whose stamps jitter, without the loss."""
        signal = self.models[drive].drive.signals[p.sensor]
        slope = np.abs(np.gradient(p.values, p.time, axis=0)).max(axis=1)
        alike = max(1.0, STAMPS_ALIKE / float(np.median(np.diff(p.time))))
        return SampleWeights(_run_weights(signal.values), alike * signal.stamp_errors(slope) ** 2)

    def _innovations(self, p: Prediction, plain: SampleWeights) -> FloatArray:
        """Largest innovation (m,) of each sample, in standard deviations."""
        innovations, _ = whiten(p.residual, p.time, self.noise[p.sensor], plain)
        size: FloatArray = np.abs(innovations).max(axis=1)
        return size

    def outliers(self, predictions: Sequence[Sequence[Prediction]], limit: float) -> int:
        """Return the number of samples with an innovation beyond the limit.

        Parameters
        ----------
        predictions : sequence of sequence of Prediction
            Predictions of each drive, one per sensor.
        limit : float
            In standard deviations.
        """
        return sum(
            int(np.count_nonzero(self._innovations(p, self._plain_weights(drive, p)) > limit))
            for drive, found in enumerate(predictions)
            for p in found
        )

    def weights(self, drive: int) -> dict[Sensor, FloatArray]:
        """Return the weight of each sample (m,) of a drive, at most 1, by sensor."""
        return {
            sensor: 1.0 / (1.0 / s.weights + s.stamps / self.noise[sensor].white ** 2)
            for sensor, s in self._samples[drive].items()
        }

    def close(self) -> None:
        """End the threads."""
        self._pool.shutdown()


def _run_weights(values: FloatArray) -> FloatArray:
    """Weights (m,) of readings (m, c): a run of equal ones has one rounding error, so counts once.

    Otherwise the many equal readings of a signal that changes by less than one step of the sensor
    would show, with a far too small uncertainty, that it does not change.
    """
    runs = np.append(0, np.cumsum(np.any(np.diff(values, axis=0) != 0.0, axis=1)))
    weights: FloatArray = 1.0 / np.bincount(runs)[runs]
    return weights


def _columns(p: Prediction, channel: int) -> FloatArray:
    """Jacobian and residual of one channel, (m, k + q + 1)."""
    return np.column_stack([p.jacobian[:, channel], p.residual[:, channel]])
