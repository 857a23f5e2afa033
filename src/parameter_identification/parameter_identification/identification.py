"""IDENTIFY: the unknown parameters of a vehicle from recorded drives, with their uncertainty.

    drives = [read_measured_drive(bag, vehicle) for bag in bags]
    found = identify(drives, vehicle, profiles=True)
    found.parameters["cornering_stiffness"].estimate, found.intervals, found.white

Identification is the whole way from drives to a result that can be reported; the steps on it (model
of a drive, least squares, noise, intervals, tests) are in `estimation`.

The method is nonlinear least squares on all signals of all drives together, each signal weighted by
its noise, bounded by the ranges of the vehicle file, from the best of a Sobol' sequence of starts.
Besides the parameters it estimates for every drive the nuisances: start pose and speed, the delay
of each sensor's clock, the bias of the gyro.

A range is knowledge too: it enters as a Gaussian of the same mean and variance (1/12 of its square)
unless a `GaussianPrior` is given, e.g. that of an earlier identification
(`Identification.posterior`). What the drives do not show therefore keeps the middle and the width
of its range, and is named in `Identification.hidden`. The noise is estimated from the residuals;
where they are correlated in time, the correlation is part of the noise and widens the intervals.
So do drives that contradict each other. A parameter that the data pull far beyond the end of its
range is not shown; where the model is wrong for the vehicle, neither is one at the end.
"""

import math
import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from threadpoolctl import threadpool_limits

from parameter_identification.drives.measured import Input, MeasuredDrive
from parameter_identification.drives.names import told_apart
from parameter_identification.estimation.bootstrap import REPEATS, Redraw, bootstrap_deviations
from parameter_identification.estimation.checks import check_drives
from parameter_identification.estimation.estimates import estimates_of
from parameter_identification.estimation.inputs import Inputs, measured_inputs
from parameter_identification.estimation.interval_correction import (
    MIN_DRIVES_FOR_SCATTER,
    interval_correction,
)
from parameter_identification.estimation.intervals import check_level
from parameter_identification.estimation.mixture import Mixture
from parameter_identification.estimation.model import DriveModel
from parameter_identification.estimation.motion_model import OF_INPUT
from parameter_identification.estimation.motions import Simulator
from parameter_identification.estimation.observability import hidden_combinations
from parameter_identification.estimation.optimum import (
    Optimum,
    counts_to_optimum,
    find_optimum,
    rough_minima,
)
from parameter_identification.estimation.prior import GaussianPrior, box_prior
from parameter_identification.estimation.problem import LeastSquares, Loss
from parameter_identification.estimation.profiles import ProfileCurve, profile
from parameter_identification.estimation.results import (
    Combination,
    DriveFit,
    EffectEstimate,
    Estimate,
    HeldOut,
    Identification,
    NuisanceEstimate,
    Profile,
    common_truth,
)
from parameter_identification.estimation.tally import Tally
from parameter_identification.estimation.unknown import restrict
from parameter_identification.estimation.validation import (
    effects_of_drives,
    fits_of_drives,
    predict_each_other,
    predict_held_out,
    whiteness_of_residuals,
)
from parameter_identification.estimation.weighing import weigh_effects
from parameter_identification.estimation.whiteness import coloured
from tricycle_core.errors import IdentificationError
from tricycle_core.quantities import Progress
from tricycle_sim.effects import EFFECTS, Effect, effects_of
from tricycle_sim.vehicle import Vehicle
from tricycle_sim.vehicle.batch import CommandedBatch

__all__ = [
    "EFFECTS", "Combination", "DriveFit", "EffectEstimate", "Estimate", "GaussianPrior", "HeldOut",
    "Identification", "IdentificationError", "Inputs", "Loss", "NuisanceEstimate", "Profile",
    "identify",
]  # fmt: skip

OUTLIER = 6.0  # standard deviations from which samples are counted as outliers


def identify(
    drives: Sequence[MeasuredDrive],
    vehicle: Vehicle,
    *,
    parameters: Sequence[str] | None = None,
    hold_others: bool = False,
    other_vehicle: bool = False,
    prior: GaussianPrior | None = None,
    held_out: Sequence[MeasuredDrive] = (),
    effects: Sequence[str] = (),
    weighed: bool = False,
    inputs: Inputs | str = Inputs.EITHER,
    simulator: Simulator = CommandedBatch,
    loss: Loss | str = Loss.SQUARED,
    starts: int = 4,
    level: float = 0.95,
    profiles: bool = False,
    redraw: Redraw | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> Identification:
    """Estimate unknown parameters from drives.

    Parameters
    ----------
    drives : sequence of MeasuredDrive
        One or more, of the same vehicle. Of equal names, the later ones get a number.
    vehicle : Vehicle
        Known constants, nominal values and ranges.
    parameters : sequence of str, optional
        Names of those asked for. Default: all unknown.
    hold_others : bool
        Whether the others keep their nominal values. By default they are estimated too, with their
        ranges as prior: the intervals count that they are unknown.
    other_vehicle : bool
        Whether drives may have been planned for another vehicle, as with an earlier file of this
        one, of which a constant has been corrected since.
    prior : GaussianPrior, optional
        Knowledge before the drives. Parameters that it does not name keep their ranges.
    held_out : sequence of MeasuredDrive, optional
        Drives to be predicted with the estimates.
    effects : sequence of str, optional
        Effects (of `EFFECTS`) that are estimated beside the parameters.
    weighed : bool
        Whether the result is the average over the models with and without each effect, instead of
        that with all of them. Its intervals are those of the average, never profiles.
    inputs : Inputs or str
        Whether steering and wheels follow their commands, as servo and speed loop of the vehicle
        file do, or move as measured. With an FMU they follow the commands.
    simulator : callable
        Simulator of the drives: our own model, or an FMU (`tricycle_sim.fmi.batch.FmuSimulator`).
    loss : Loss or str
        Cost of a residual.
    starts : int
        Number of fits from different starts, so that the global minimum is found.
    level : float
        Probability of the intervals.
    profiles : bool
        Whether intervals are those of the profile likelihood, which takes a few times as long. Not
        from 10 drives on, or where a range is contradicted: linear intervals count that. Nor with
        `redraw`.
    redraw : callable, optional
        Gives the drives anew, for what errs alike in all of them before the fit: the intervals are
        at least as wide as estimates from drives of a known vehicle scatter and err.
    seed : int
        Seed of the starts, and of what is redrawn.
    progress : callable, optional
        Called with the number of steps done and in all: fits, and estimates of a sensor's noise.

    Raises
    ------
    IdentificationError
        If there is no drive, one comes twice, there is no such parameter, too little motion, a
        drive was planned for another vehicle, there is no measured input that shall be used, or an
        argument is none of those that are possible.
    DesignError
        Inputs or a loss of another name.
    """
    begun = time.perf_counter()
    _check_arguments(drives, held_out, effects, starts)
    check_level(level)
    inputs, loss = Inputs(inputs), Loss(loss)
    asked = restrict(vehicle, tuple(vehicle.unknown) if parameters is None else parameters)
    known = asked if hold_others else vehicle
    everything = [*drives, *held_out]
    check_drives(everything, vehicle, other_vehicle=other_vehicle)
    everything = told_apart(everything)
    drives, held_out = everything[: len(drives)], everything[len(drives) :]
    measured = _measured(everything, vehicle, inputs, simulator)
    unneeded = {name for one in measured for name in OF_INPUT[one]}
    estimated = tuple(e for e in effects_of(known, effects) if e.name not in unneeded)
    before = box_prior(known, prior)

    def problem_with(chosen: Sequence[Effect]) -> LeastSquares:
        models = [
            DriveModel(known, drive, chosen, simulator, measured=measured) for drive in drives
        ]
        return LeastSquares(models, before.mean, before.information, loss)

    # for small matrices more threads only cost
    with threadpool_limits(1, user_api="blas"), problem_with(estimated) as problem:
        shown = [i for i, name in enumerate(known.unknown) if name in asked.unknown]
        weighs = bool(weighed and problem.variables.constant_effects)
        if weighs or len(drives) >= MIN_DRIVES_FOR_SCATTER or redraw is not None:
            profiles = False
        to_optimum = starts * bool(estimated) + counts_to_optimum(problem, starts)
        to_end = to_optimum + weighs + len(shown) * profiles + REPEATS * (redraw is not None)
        tally = Tally(progress, to_end)
        near = None
        if estimated:  # without effects a search takes a tenth of the time
            with problem_with(()) as without:
                near = rough_minima(without, starts=starts, seed=seed, count=tally)
        optimum = find_optimum(
            problem, starts=starts, seed=seed, level=level, near=near, count=tally
        )
        tally.pass_to(to_optimum)
        average: Mixture | None = None
        acts: dict[str, float] = {}
        if weighs:
            optimum, average, acts = weigh_effects(problem, optimum)
            tally()
        least = None
        if redraw is not None:
            least = bootstrap_deviations(
                problem, optimum, redraw, loss=loss, level=level, seed=seed, count=tally
            )
        predictions = problem.predictions(optimum.fit.at)
        tested = whiteness_of_residuals(problem, predictions)
        missed, missing = 0.0, None
        if len(drives) > 1 and (held_out or len(drives) < MIN_DRIVES_FOR_SCATTER):
            cross = predict_each_other(problem, optimum, predictions)
            missed = cross.missed
            missing = cross.estimates if missed and len(drives) < MIN_DRIVES_FOR_SCATTER else None
        correction = interval_correction(
            problem,
            optimum,
            average,
            least,
            missing=missing,
            white=not coloured(tested),
            level=level,
        )
        curves: dict[int, ProfileCurve] = {}
        if profiles and not correction.beyond.any() and not correction.scatter > 1.0:
            optimum, curves = _profiled(problem, optimum, shown, level, tally)
        tally.pass_to(to_end)
        k, model = problem.k, problem.models[0]
        optimum = replace(optimum, covariance=correction.covariance)
        estimates = estimates_of(
            vehicle=known,
            at=optimum.fit.at[:k],
            std=np.sqrt(np.diag(optimum.covariance))[:k],
            level=level,
            beyond=correction.beyond,
            widening=correction.widening,
            average=average,
            curves=curves,
            rivals=optimum.rivals,
        )
        return Identification(
            vehicle=vehicle.name,
            vehicle_hash=vehicle.fingerprint,
            parameters=estimates,
            covariance=optimum.covariance[:k, :k] * np.outer(model.width, model.width),
            fixed={n: v for n, v in vehicle.nominal.items() if n not in known.unknown},
            hidden=hidden_combinations(problem, optimum),
            noise=problem.noise,
            whiteness=tested,
            drives=fits_of_drives(problem, optimum, predictions),
            held_out=tuple(
                predict_held_out(problem, optimum, d, loss, level, missed) for d in held_out
            ),
            outliers=problem.outliers(predictions, OUTLIER),
            rivals=tuple(model.motion.parameters(z) for z in optimum.rivals),
            starts=optimum.starts,
            truth=common_truth(drive.truth for drive in drives),
            level=level,
            seed=seed,
            seconds=time.perf_counter() - begun,
            effects=effects_of_drives(problem, optimum, acts),
            scatter=correction.scatter,
            missed=math.sqrt(missed),
            measured=measured,
            friction_used=max(m.motion.friction_used(optimum.fit.at[:k]) for m in problem.models),
            converged=optimum.fit.converged,
        ).only(asked.unknown)


def _check_arguments(
    drives: Sequence[MeasuredDrive],
    held_out: Sequence[MeasuredDrive],
    effects: Sequence[str],
    starts: int,
) -> None:
    """Refuse one item where a list is needed, and less than what can be identified from."""
    for name, given in (("drives", drives), ("held_out", held_out)):
        if isinstance(given, MeasuredDrive):
            raise IdentificationError(f"{name}: a list of drives is needed, as [drive]")
    if isinstance(effects, str):
        raise IdentificationError(f"effects: a list of names is needed, as [{effects!r}]")
    if not drives:
        raise IdentificationError("no drive: nothing to identify from")
    if starts < 1:
        raise IdentificationError(f"starts = {starts}: must be 1 or more")


def _measured(
    drives: Sequence[MeasuredDrive], vehicle: Vehicle, inputs: Inputs, simulator: Simulator
) -> frozenset[Input]:
    """Inputs that move as measured; other simulators than our own have actuators of their own."""
    if simulator is CommandedBatch:
        return measured_inputs(drives, vehicle, inputs)
    if inputs is Inputs.MEASURED:
        raise IdentificationError("an FMU follows its commands, not what was measured")
    return frozenset()


def _profiled(
    problem: LeastSquares, optimum: Optimum, shown: Sequence[int], level: float, tally: Tally
) -> tuple[Optimum, dict[int, ProfileCurve]]:
    """The profile likelihood of some parameters, by number; the lowest point met is a rival."""
    curves = {}
    for i in shown:
        curves[i] = profile(problem, optimum.fit, optimum.covariance, i, level)
        tally()
    if lower := [curve.lower for curve in curves.values() if curve.lower is not None]:
        lowest = min(lower, key=lambda fit: fit.cost)
        optimum = replace(optimum, rivals=(*optimum.rivals, lowest.at[: problem.k]))
    return optimum, curves
