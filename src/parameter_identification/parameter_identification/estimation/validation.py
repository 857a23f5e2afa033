"""How well the fitted model predicts: the drives it was fitted to, and held-out ones."""

import math
from collections.abc import Sequence

import numpy as np

from parameter_identification.drives.measured import MeasuredDrive, Sensor
from parameter_identification.estimation.model import DriveModel, Prediction
from parameter_identification.estimation.optimum import Optimum
from parameter_identification.estimation.problem import LeastSquares, Loss
from parameter_identification.estimation.results import DriveFit, HeldOut, NuisanceEstimate
from parameter_identification.estimation.whiteness import Whiteness, whiteness
from tricycle_core.quantities import FloatArray


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
        Of each drive at the best fit.
    """
    nominal = optimum.fit.at.copy()
    nominal[: problem.k] = _nominal(problem.models[0])
    std = np.sqrt(np.diag(optimum.covariance))
    fits, first = [], problem.k
    for drive, (model, before, after) in enumerate(
        zip(problem.models, problem.predictions(nominal), predictions, strict=True)
    ):
        nuisances = {
            n.name: NuisanceEstimate(
                n.mean + n.std * float(optimum.fit.at[at]), n.std * float(std[at]), n.unit
            )
            for at, n in enumerate(model.nuisances, start=first)
        }
        first += len(nuisances)
        fits.append(
            DriveFit(
                name=model.drive.name,
                nuisances=nuisances,
                before={p.sensor: p for p in before},
                after={p.sensor: p for p in after},
                weights=problem.weights(drive),
            )
        )
    return tuple(fits)


def whiteness_of_residuals(
    problem: LeastSquares, predictions: Sequence[Sequence[Prediction]]
) -> tuple[Whiteness, ...]:
    """Test the weighted residuals of every channel of every drive.

    Parameters
    ----------
    problem : LeastSquares
        Holds the drives and the weights of their samples.
    predictions : sequence of sequence of Prediction
        Of each drive at the best fit.
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
        for c, (channel, residual) in enumerate(zip(p.sensor.channels, p.residual.T, strict=True))
    )


def predict_held_out(
    problem: LeastSquares, optimum: Optimum, drive: MeasuredDrive, loss: Loss
) -> HeldOut:
    """Predict a drive with the nominal and with the estimated parameters, its nuisances fitted.

    Parameters
    ----------
    problem : LeastSquares
        Holds the prior and the noise.
    optimum : Optimum
        The best fit.
    drive : MeasuredDrive
        One that was not used for it.
    loss : Loss
        Of the residuals.
    """
    k, model = problem.k, DriveModel(problem.models[0].vehicle, drive)
    with LeastSquares([model], problem.mean, problem.information, loss) as alone:
        alone.noise |= {
            sensor: problem.noise[sensor] for sensor in alone.noise if sensor in problem.noise
        }
        free = np.arange(alone.n) >= k
        rms = []
        for z in (_nominal(model), optimum.fit.at[:k]):
            fit = alone.minimise(np.concatenate([z, np.zeros(alone.n - k)]), free)
            (predictions,) = alone.predictions(fit.at)
            position = next(p for p in predictions if p.sensor is Sensor.POSITION)
            rms.append(float(np.sqrt(np.mean(np.sum(position.residual**2, axis=1)))))
        noise = alone.noise[Sensor.POSITION]
    return HeldOut(
        drive.name, rms[0], rms[1], math.sqrt(2.0) * math.hypot(noise.white, noise.drift)
    )


def _nominal(model: DriveModel) -> FloatArray:
    """Nominal parameters (k,) in their ranges."""
    nominal: FloatArray = (model.vehicle.nominal_point() - model.low) / model.width
    return nominal
