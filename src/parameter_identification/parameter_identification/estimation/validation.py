"""Predictions by the fitted model: the drives it was fitted to, and held-out ones."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from parameter_identification.drives.measured import MeasuredDrive, Sensor
from parameter_identification.estimation import chi_square
from parameter_identification.estimation.model import DriveModel, Prediction
from parameter_identification.estimation.noise import NoiseLevel
from parameter_identification.estimation.optimum import Optimum
from parameter_identification.estimation.problem import LeastSquares, Loss
from parameter_identification.estimation.results import (
    DriveFit,
    EffectEstimate,
    HeldOut,
    Lack,
    NuisanceEstimate,
)
from parameter_identification.estimation.whiteness import Whiteness, whiteness
from tricycle_core.quantities import FloatArray
from tricycle_sim.effects import SPEED_DEVIATION, TURN_DEVIATION

DEVIATIONS = ((SPEED_DEVIATION, "%", 100.0), (TURN_DEVIATION, "(1/m)", 1.0))
"""Deviations that go on all along a drive: name, unit that is shown, and the factor to it."""
LEAST_CHANCE = 0.01  # of a drive so far from its prediction: below it the prediction misses it
NO_SIZE = 0.01  # of a deviation, in standard deviations of its prior, up to which it does not act


def fits_of_drives(
    problem: LeastSquares, optimum: Optimum, predictions: Sequence[Sequence[Prediction]]
) -> tuple[DriveFit, ...]:
    """Return each drive predicted with the nominal vehicle and with the estimates.

    Parameters
    ----------
    problem : LeastSquares
        Holds the drives.
    optimum : Optimum
        The best fit.
    predictions : sequence of sequence of Prediction
        Predictions of each drive at the best fit, one per sensor.
    """
    nominal = optimum.fit.at.copy()
    nominal[: problem.k] = problem.models[0].nominal
    std = np.sqrt(np.diag(optimum.covariance))
    fits = []
    for drive, (model, before, after) in enumerate(
        zip(problem.models, problem.predictions(nominal), predictions, strict=True)
    ):
        nuisances = {
            n.name: NuisanceEstimate(
                n.mean + n.std * float(optimum.fit.at[at]), n.std * float(std[at]), n.unit
            )
            for at, n in zip(problem.variables.nuisances_of(drive), model.nuisances, strict=True)
            if n.effect is None
        }
        fits.append(
            DriveFit(
                name=model.drive.name,
                nuisances=nuisances,
                before={p.sensor: p for p in before},
                after={p.sensor: p for p in after},
                weights=problem.weights(drive),
                lack=_lack(problem, optimum, drive, after),
                recording=model.drive.recording,
                map_estimated=model.drive.map_estimated,
                steering_late=model.drive.steering_late,
            )
        )
    return tuple(fits)


def _position(predictions: Iterable[Prediction]) -> Prediction:
    """The predicted positions of a drive: every drive has some."""
    return next(p for p in predictions if p.sensor is Sensor.POSITION)


def _lack(
    problem: LeastSquares, optimum: Optimum, drive: int, predictions: Sequence[Prediction]
) -> Lack:
    """Misfit along a drive: residuals of the positions, and the deviations."""
    model, at = problem.models[drive], problem.variables.nuisances_of(drive)
    z, own = optimum.fit.at[: problem.k], optimum.fit.at[at]
    position = _position(predictions)
    seconds, second, count = np.unique(
        np.floor(position.time), return_inverse=True, return_counts=True
    )
    time = seconds + 0.5
    conditions = model.conditions(z, own, np.concatenate([position.time, time]))
    heading = conditions[3, : len(position.time)]
    x, y = position.residual.T
    along = np.cos(heading) * x + np.sin(heading) * y
    across = np.cos(heading) * y - np.sin(heading) * x
    noise = problem.noise[Sensor.POSITION].white / np.sqrt(count)
    values = {
        "ahead of the model / m": np.bincount(second, along) / count,
        "left of the model / m": np.bincount(second, across) / count,
    }
    deviations = dict.fromkeys(values, noise)
    std = np.sqrt(np.diag(optimum.covariance))[at]
    for name, unit, factor in DEVIATIONS:
        knots = model.motion.knots_of(name)
        if len(knots) and problem.sizes.by_name()[name] > NO_SIZE:
            scale = factor * model.nuisances[knots[0]].std
            of_knots = np.linspace(0.0, model.drive.commands.duration, len(knots))
            values[f"{name} / {unit}"] = np.interp(time, of_knots, scale * own[knots])
            deviations[f"{name} / {unit}"] = np.interp(time, of_knots, scale * std[knots])
    speed, steering, lateral, _ = conditions[:, len(position.time) :]
    return Lack(time, speed, steering, lateral, values, deviations)


def effects_of_drives(
    problem: LeastSquares, optimum: Optimum, acts: Mapping[str, float]
) -> tuple[EffectEstimate, ...]:
    """Return the estimate of each effect: those of all drives, then those of each drive.

    Parameters
    ----------
    problem : LeastSquares
        Holds the drives.
    optimum : Optimum
        The best fit.
    acts : mapping of str to float
        Probability of each effect, where they were weighed.
    """
    std, ends = np.sqrt(np.diag(optimum.covariance)), problem.variables.at_an_end(optimum.fit.at)
    estimates = []
    for drive, model in enumerate(problem.models):
        for i, (at, n) in enumerate(
            zip(problem.variables.nuisances_of(drive), model.nuisances, strict=True)
        ):
            e, own = n.effect, i >= model.shared
            if e is None or e.process or (drive and not own):
                continue
            estimates.append(
                EffectEstimate(
                    name=e.name,
                    unit=e.unit,
                    estimate=n.std * float(optimum.fit.at[at]),
                    standard_deviation=n.std * float(std[at]),
                    prior=e.std,
                    drive=model.drive.name if own else "",
                    acts=acts.get(e.name),
                    at_an_end=bool(ends[at]),
                )
            )
    sizes = problem.sizes.by_name()
    chances = problem.sizes.chances(problem.quadratic(optimum.fit.at))
    for e in problem.models[0].effects:
        if e.process and e.name in sizes:  # no drive starts from rest: none deviates at its start
            size, known = e.std * sizes[e.name], acts.get(e.name)
            estimates.append(
                EffectEstimate(e.name, e.unit, 0.0, size, e.std, acts=known, chance=chances[e.name])
            )
    return tuple(estimates)


def whiteness_of_residuals(
    problem: LeastSquares, predictions: Sequence[Sequence[Prediction]]
) -> tuple[Whiteness, ...]:
    """Test the weighted residuals of every channel of every drive.

    Parameters
    ----------
    problem : LeastSquares
        Holds the drives and the weights of their samples.
    predictions : sequence of sequence of Prediction
        Predictions of each drive at the best fit, one per sensor.
    """
    return tuple(
        whiteness(
            model.drive.name,
            channel,
            p.time,
            p.residual[:, c] + p.values[:, c],
            residual * np.sqrt(problem.weights(drive)[p.sensor]),
        )
        for drive, (model, found) in enumerate(zip(problem.models, predictions, strict=True))
        for p in found
        for c, (channel, residual) in enumerate(zip(p.channels, p.residual.T, strict=True))
    )


@dataclass(frozen=True, eq=False)
class CrossPrediction:
    """Result of predicting each drive from the others.

    Attributes
    ----------
    missed : float
        Variance of positions [m^2] by which the worst drive is farther off than expected; 0 where
        all are as near as they may be by chance.
    estimates : ndarray of float, shape (d, k)
        Parameters without each drive, in their ranges.
    """

    missed: float
    estimates: FloatArray


def predict_each_other(
    problem: LeastSquares, optimum: Optimum, predictions: Sequence[Sequence[Prediction]]
) -> CrossPrediction:
    """Predict each drive from the others, its nuisances fitted, as far as the motion is linear.

    Parameters
    ----------
    problem : LeastSquares
        Holds the drives, two or more.
    optimum : Optimum
        The best fit.
    predictions : sequence of sequence of Prediction
        Predictions of each drive at the best fit, one per sensor.
    """
    v, missed, estimates = optimum.fit.at, 0.0, []
    free = (v != 0.0) & ~problem.variables.at_an_end(v)  # other effects are held there
    for drive, (others, covariance, alone) in enumerate(problem.by_the_others(v, free)):
        model = problem.models[drive]
        estimates.append(others[: problem.k])
        known, fitted = problem.k + model.shared, _fitted(model)
        own = problem.variables.nuisances_of(drive)[model.shared :]
        change = np.append((others - v)[:known], -v[own])
        bent = alone.gradient + alone.information[:, ~fitted] @ change[~fitted]
        change[fitted] = -np.linalg.solve(alone.information[np.ix_(fitted, fitted)], bent[fitted])
        position = _position(predictions[drive])
        residual = position.residual + position.jacobian @ change
        expected = _held_covariance(problem, optimum, model)
        expected[:known, :known] = covariance[:known, :known]
        by_rest = _by_rest(position, alone.information, fitted)
        weights = problem.weights(drive)[Sensor.POSITION]
        of_model = expected[np.ix_(~fitted, ~fitted)] @ np.einsum(
            "t,tci,tcj->ij", weights, by_rest, by_rest, optimize=True
        )
        noise = problem.noise[Sensor.POSITION]
        missed = max(missed, _excess(position.time, residual, weights, of_model, noise))
    return CrossPrediction(missed, np.array(estimates))


def _excess(
    time: FloatArray,
    residual: FloatArray,
    weights: FloatArray,
    of_model: FloatArray,
    level: NoiseLevel,
) -> float:
    """Variance by which residuals (m, 2) exceed what is expected; 0 where that may be chance.

    Their weighted squares are compared with a chi-square distribution of the same mean and
    variance. The non-zero eigenvalues of their covariance by the model are those of `of_model`.
    """
    noise = 2.0 * float(np.sum(level.white**2 + weights * level.drift**2))
    alike = max(1.0, level.drift_time / float(np.median(np.diff(time))))
    by_model = float(np.trace(of_model))
    mean = by_model + noise
    half_variance = float(np.sum(of_model * of_model.T))
    half_variance += (2.0 * by_model + noise) * (level.white**2 + alike * level.drift**2)
    degrees = mean**2 / half_variance
    found = float(np.sum(weights[:, np.newaxis] * residual**2))
    if chi_square.tail(degrees * found / mean, degrees) >= LEAST_CHANCE:
        return 0.0
    return (found - mean) / float(weights.sum())


def predict_held_out(
    problem: LeastSquares,
    optimum: Optimum,
    drive: MeasuredDrive,
    loss: Loss,
    level: float,
    missed: float,
) -> HeldOut:
    """Predict a drive with the nominal and with the estimated parameters, its nuisances fitted.

    Parameters
    ----------
    problem : LeastSquares
        Holds the prior and the noise.
    optimum : Optimum
        The best fit.
    drive : MeasuredDrive
        Drive that was not used for the fit.
    loss : Loss
        Cost of a residual.
    level : float
        Probability of the band around the predicted positions.
    missed : float
        Variance of positions [m^2] that the model has at least: that of a `CrossPrediction`.
    """
    k = problem.k
    model = problem.models[0].of(drive)
    with LeastSquares([model], problem.mean, problem.information, loss) as alone:
        alone.noise |= {
            sensor: problem.noise[sensor] for sensor in alone.noise if sensor in problem.noise
        }
        known, free = k + model.shared, _fitted(model)
        rms = []
        unaffected = np.zeros(model.shared)
        for shown in (np.append(model.nominal, unaffected), optimum.fit.at[:known]):
            fit = alone.minimise(alone.variables.beginning(shown), free)
            alone.weigh(fit.at)
            fit = alone.minimise(fit.at, free)
            (predictions,) = alone.predictions(fit.at)
            position = _position(predictions)
            rms.append(position.rms)
        information = alone.quadratic(fit.at).information
        by_rest = _by_rest(position, information, free)
        covariance = _held_covariance(problem, optimum, model)[np.ix_(~free, ~free)]
        covariance = by_rest @ covariance @ by_rest.transpose(0, 2, 1)
        covariance *= max(1.0, missed / np.mean(np.trace(covariance, axis1=1, axis2=2)))
        noise = alone.noise[Sensor.POSITION]
        variance = noise.white**2 + noise.drift**2
        covariance += variance * np.eye(2)
        whitened = np.linalg.solve(covariance, position.residual[:, :, np.newaxis])[:, :, 0]
        distance = np.sum(position.residual * whitened, axis=1)
    return HeldOut(
        drive.name,
        rms_nominal=rms[0],
        rms_estimated=rms[1],
        noise=math.sqrt(2.0 * variance),
        expected=float(np.sqrt(np.mean(np.trace(covariance, axis1=1, axis2=2)))),
        inside=float(np.mean(distance <= chi_square.quantile(level, 2))),
    )


def _fitted(model: DriveModel) -> NDArray[np.bool_]:
    """True for variables of a drive (k + q,) fitted where it is predicted: no effects."""
    of_drive = [n.effect is None for n in model.nuisances[model.shared :]]
    return np.append(np.zeros(len(model.low) + model.shared, dtype=bool), of_drive)


def _by_rest(
    position: Prediction, information: FloatArray, fitted: NDArray[np.bool_]
) -> FloatArray:
    """Derivatives (m, 2, r) of residuals by r variables, while those fitted to the drive follow.

    What is fitted compensates a part of the error of those r variables.
    """
    rest = ~fitted
    taken = np.linalg.solve(information[np.ix_(fitted, fitted)], information[np.ix_(fitted, rest)])
    found: FloatArray = position.jacobian[:, :, rest] - position.jacobian[:, :, fitted] @ taken
    return found


def _held_covariance(problem: LeastSquares, optimum: Optimum, model: DriveModel) -> FloatArray:
    """Covariance of the variables of a drive that was not used.

    An effect that each drive has for itself is taken to be as large as in the drives that were
    used. So is the share of a deviation that is constant along a drive.
    """
    known = problem.k + model.shared
    moments = optimum.covariance + np.outer(optimum.fit.at, optimum.fit.at)
    covariance = np.zeros((known + len(model.nuisances) - model.shared,) * 2)
    covariance[:known, :known] = optimum.covariance[:known, :known]
    of_effect = problem.variables.constant_effects
    for i, nuisance in enumerate(model.nuisances[model.shared :], start=known):
        if nuisance.effect in of_effect:
            covariance[i, i] = np.mean(np.diag(moments)[of_effect[nuisance.effect]])
    for name, size in problem.sizes.by_name().items():
        knots = problem.k + model.motion.knots_of(name)
        share = _staying_share(problem, moments, name)
        correlation = share + (1.0 - share) * np.eye(len(knots))
        covariance[np.ix_(knots, knots)] = size**2 * correlation
    return covariance


def _staying_share(problem: LeastSquares, moments: FloatArray, name: str) -> float:
    """Share of a deviation's variance that is constant along each drive: its knots' correlation."""
    together = alone = 0.0
    for drive, model in enumerate(problem.models):
        knots = problem.variables.nuisances_of(drive)[model.motion.knots_of(name)]
        if len(knots) > 1:
            own = moments[np.ix_(knots, knots)]
            together += (np.sum(own) - np.trace(own)) / (len(knots) - 1)
            alone += np.trace(own)
    return float(np.clip(together / alone, 0.0, 1.0)) if alone else 0.0
