"""Identification during a drive: what its samples have shown so far, beside what was planned.

    live = LiveIdentification(vehicle)
    live.prepare()                                 # compiles what an update needs
    live.sense(Sensor.POSITION, stamp, (x, y))     # as they come, before the start event too
    live.begin(commands, start, Planned.of(plan, vehicle))
    live.update()                                  # once a second: estimates and deviations
    live.complete()                                # after the drive: whether all samples have come
    live.end()                                     # estimates from all of them, and the verdict

An update may take longer than the time between samples: `live.snapshot()` is one that another
thread can update or end meanwhile, one at a time.

Every update fits all samples so far by the model, noise and prior of `identify`, from where the
last one ended: a step or two; the last one goes on until noise and fit belong together. Intervals
are linear, there is one start and there are no effects.
"""

import math
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace

import numpy as np
from threadpoolctl import threadpool_limits

from excitation_planner.design.noise import STANDSTILL, MeasurementNoise
from excitation_planner.design.prior import BoxPrior
from excitation_planner.plan import Plan
from excitation_planner.planning.prediction import predicted_progress
from parameter_identification.drives.measured import (
    STAMP_JITTER,
    MeasuredDrive,
    Sensor,
    Signal,
    resolved,
)
from parameter_identification.drives.recorded import SteeredLeadIn
from parameter_identification.drives.samples import measures_nothing, missing
from parameter_identification.drives.simulated import SensedMotion, SensorNoise, measure
from parameter_identification.estimation.checks import MIN_POSITIONS, check_motion
from parameter_identification.estimation.intervals import relative_half_width
from parameter_identification.estimation.model import DriveModel
from parameter_identification.estimation.noise import NoiseLevel
from parameter_identification.estimation.optimum import ROUGH, settled
from parameter_identification.estimation.prior import GaussianPrior, box_prior
from parameter_identification.estimation.problem import LeastSquares, Loss
from tricycle_core.errors import IdentificationError
from tricycle_core.quantities import FloatArray, with_deviation
from tricycle_core.stamps import SECOND
from tricycle_core.timing import TICK
from tricycle_sim.commands import Commands
from tricycle_sim.vehicle import Vehicle
from tricycle_sim.vehicle.batch import simulate

_MADE_UP = 3.0  # s of the drive that `LiveIdentification.prepare` makes up
_LIVE = (  # sensors that a monitor listens to
    *(Sensor.POSITION, Sensor.HEADING, Sensor.YAW_RATE),
    *(Sensor.WHEEL_SPEED, Sensor.LATERAL_ACCELERATION),
)

OF_POSE = Sensor.POSITION, Sensor.HEADING
"""Sensors that may tell zeros only, on a way along an axis; others then measure nothing."""

KEPT = 5 * SECOND
"""Age of samples that are kept without a drive [ns]: the start event may be heard late."""

JUMP = SECOND
"""Step back of the stamps [ns] from which the clock has begun anew."""

AS_PLANNED = 1.2
"""Ratio of a standard deviation to the planned one up to which a drive was as informative."""

NOISIER = 1.5
"""Ratio of a sensor's noise to the planned one from which it is a reason."""

SLOWER = 0.9
"""Share of the commanded way below which a drive was slower than planned."""

CLIPPED = 0.95
"""Share of the commanded steering below which it was clipped."""

REACHED = 0.5
"""Time in which the steering reaches a commanded angle [s]."""

LONGER = 1.2
"""How many times as long the drive has become when an update estimates the noise again."""

CHORD = 0.5
"""Time between the positions that a way is summed over [s]: shorter ones would add noise."""


@dataclass(frozen=True, eq=False)
class Planned:
    """Progress that a plan expects of its drive.

    Attributes
    ----------
    target : str
        Parameter that it is to excite.
    noise : MeasurementNoise
        Noise of the sensors.
    time : ndarray of float, shape (s,)
        Times since the start event [s].
    std : ndarray of float, shape (s, k)
        Standard deviations of the unknown parameters then, in their units.
    """

    target: str
    noise: MeasurementNoise
    time: FloatArray
    std: FloatArray

    @classmethod
    def of(cls, plan: Plan, vehicle: Vehicle, prior: GaussianPrior | None = None) -> "Planned":
        """Return the progress that a plan expects of its drive.

        Parameters
        ----------
        plan : Plan
            Plan of the drive alone, also where it was planned as one of several.
        vehicle : Vehicle
            Vehicle that has the unknown parameters.
        prior : GaussianPrior, optional
            Knowledge before the drive, as that of `LiveIdentification.begin`.

        Raises
        ------
        DesignError
            If the plan predicts nothing.
        """
        before = None if prior is None else box_prior(vehicle, prior)
        return cls(plan.target, plan.noise, *predicted_progress(plan, vehicle, before))

    def at(self, time: float) -> FloatArray:
        """Return the standard deviations (k,) at a time since the start event [s].

        Parameters
        ----------
        time : float
            Time since the start event [s].
        """
        return np.array([np.interp(time, self.time, column) for column in self.std.T])


@dataclass(frozen=True)
class LiveEstimate:
    """Estimate of a parameter at a moment of a drive.

    Attributes
    ----------
    unit : str
        Unit of the parameter, in which all values are.
    estimate, standard_deviation : float
        From the samples so far and the prior.
    planned : float, optional
        Standard deviation that the plan predicts for this moment.
    """

    unit: str
    estimate: float
    standard_deviation: float
    planned: float | None

    def __str__(self) -> str:
        text = with_deviation(self.estimate, self.standard_deviation)
        expected = "" if self.planned is None else f" (planned ± {self.planned:.2g})"
        return f"{text}{expected} {self.unit}".rstrip()


@dataclass(frozen=True)
class Moment:
    """Estimates of the unknown parameters at a moment of a drive.

    Attributes
    ----------
    elapsed : float
        Time of the newest position since the start event [s].
    parameters : mapping of str to LiveEstimate
        The unknown ones.
    """

    elapsed: float
    parameters: Mapping[str, LiveEstimate]

    def known(self, targets: Sequence[str], tolerance: float) -> bool:
        """Return whether the 95 % interval of every target is within a tolerance.

        Parameters
        ----------
        targets : sequence of str
            Names of parameters.
        tolerance : float
            Half width of the interval, as a share of the estimate.
        """
        found = [self.parameters[name] for name in targets]
        return all(
            relative_half_width(e.estimate, e.standard_deviation) <= tolerance for e in found
        )


@dataclass(frozen=True)
class DriveVerdict:
    """Whether a drive was as informative as planned.

    Attributes
    ----------
    target : str
        Parameter that the drive was planned for.
    estimate : LiveEstimate
        Estimate of that parameter after the drive.
    before : float
        Standard deviation of it before the drive.
    reasons : tuple of str
        Why it was less informative, as far as they are seen.
    """

    target: str
    estimate: LiveEstimate
    before: float
    reasons: tuple[str, ...]

    @property
    def ratio(self) -> float:
        """Root of planned over added information; above 1 the drive taught less than planned."""
        stds = self.estimate.standard_deviation, self.estimate.planned or math.inf
        added, planned = (std**-2 - self.before**-2 for std in stds)
        return math.sqrt(max(planned, 0.0) / added) if added > 0.0 else math.inf

    @property
    def informative(self) -> bool:
        """Whether the drive was as informative as planned."""
        return self.ratio <= AS_PLANNED

    def __str__(self) -> str:
        how = "as informative as planned" if self.informative else "less informative than planned"
        return "; ".join([f"{how}: {self.target} {self.estimate}", *self.reasons])


@dataclass(eq=False)
class _LastFit:
    """Where the last fit of a drive ended."""

    z: FloatArray | None = None  # parameters in their ranges
    nuisances: dict[str, float] = field(default_factory=dict)  # in their units
    noise: dict[Sensor, NoiseLevel] = field(default_factory=dict)
    noise_until: float = 0.0  # end of the samples that it was estimated from, s
    rate: dict[Sensor, float] = field(default_factory=dict)  # Hz


@dataclass(eq=False)
class _Drive:
    """A drive under way."""

    commands: Commands
    start: int  # ns
    planned: Planned | None
    prior: BoxPrior
    fit: _LastFit = field(default_factory=_LastFit)  # which its snapshots share
    steered: float | None = None  # largest angle of the steering motor either way, rad
    lead_in: float = 0.0  # its end, s
    led: list[tuple[float, float]] = field(default_factory=list)  # set-points until then: s, rad
    newest: dict[Sensor, int] = field(default_factory=dict)  # stamps when last asked, ns

    @property
    def played(self) -> Commands:
        """Commands, with what the driver steered in their lead-in."""
        if not self.led:
            return self.commands
        return SteeredLeadIn(self.lead_in, *np.array(self.led).T).in_place(self.commands)

    def variables(self, problem: LeastSquares) -> FloatArray:
        """Where the next fit starts: the means of the nuisances' priors follow the samples."""
        (model,) = problem.models
        fit = self.fit
        z = problem.candidates(1, seed=0)[0][: problem.k] if fit.z is None else fit.z
        known = [(fit.nuisances.get(n.name, n.mean) - n.mean) / n.std for n in model.nuisances]
        return np.concatenate([z, known])

    def keep(self, problem: LeastSquares, at: FloatArray) -> None:
        """Keep where a fit ended."""
        (model,) = problem.models
        self.fit.z = at[: problem.k]
        values = zip(model.nuisances, at[problem.k :].tolist(), strict=True)
        self.fit.nuisances = {n.name: n.mean + n.std * v for n, v in values}
        self.fit.noise = dict(problem.noise)
        self.fit.rate = {
            sensor: (len(s.time) - 1) / float(np.ptp(s.time))
            for sensor, s in model.drive.signals.items()
        }


class LiveIdentification:
    """Estimates of a vehicle's unknown parameters while it drives.

    Parameters
    ----------
    vehicle : Vehicle
        Known constants and ranges.

    Attributes
    ----------
    began_anew : bool
        Whether the newest drive was given up because its clock began anew.
    """

    def __init__(self, vehicle: Vehicle) -> None:
        self._vehicle = vehicle
        self.began_anew = False
        self._samples: dict[Sensor, deque[tuple[int, tuple[float, ...]]]] = {
            sensor: deque() for sensor in Sensor
        }
        self._drive: _Drive | None = None

    def sense(self, sensor: Sensor, stamp: int, values: tuple[float, ...]) -> None:
        """Take a sample.

        Parameters
        ----------
        sensor : Sensor
            Sensor that measured the sample.
        stamp : int
            Stamp [ns]; a sample that is not newer than the one before is left out, unless its clock
            has begun anew: those that are not older than it then go.
        values : tuple of float
            One per channel; a sample that holds no finite number is left out.
        """
        samples = self._samples[sensor]
        if samples and samples[-1][0] - JUMP < stamp <= samples[-1][0]:
            return
        if not all(map(math.isfinite, values)):
            return
        newest = oldest = samples[-1][0] if samples else 0
        while samples and samples[-1][0] >= stamp:
            oldest, _ = samples.pop()
        if newest - oldest > JUMP // 2:  # not only one that was stamped ahead
            self._begin_anew(stamp)
        samples.append((stamp, values))
        while self._drive is None and stamp - samples[0][0] > KEPT:
            samples.popleft()

    def prepare(self) -> None:
        """Compile what updates need, which takes a while where it was never done: a made-up fit."""
        time = np.linspace(0.0, _MADE_UP, round(_MADE_UP / TICK) + 1)
        ramp = np.minimum(time, 1.0)
        commands = Commands(time, 0.1 * ramp, ramp)
        nominal = np.array([self._vehicle.nominal[name] for name in self._vehicle.unknown])
        motion = SensedMotion.of(simulate(self._vehicle, commands, nominal[None]))
        sensors = {sensor: SensorNoise(0.01) for sensor in Sensor if sensor in _LIVE}
        drive = measure(motion, commands, sensors, rng=np.random.default_rng(0))
        trial = LiveIdentification(self._vehicle)
        trial.begin(commands, 0)
        for sensor, signal in drive.signals.items():
            rows = zip(signal.time.tolist(), signal.values.tolist(), strict=True)
            for at, values in rows:
                trial.sense(sensor, round(at * SECOND), tuple(values))
        with suppress(IdentificationError):  # of samples that mean nothing
            trial.update()
            trial.end()

    def snapshot(self) -> "LiveIdentification":
        """Return a copy with the samples so far, for another thread to update or to end.

        What its fit ends at is where the next one begins: only one may be under way.
        """
        taken = LiveIdentification(self._vehicle)
        taken._samples = {sensor: samples.copy() for sensor, samples in self._samples.items()}
        if self._drive is not None:
            taken._drive = replace(self._drive, led=list(self._drive.led))
        return taken

    def steer(self, angle: float) -> None:
        """Take a measured angle of the steering motor, for the reasons of the verdict.

        Parameters
        ----------
        angle : float
            Left positive [rad]; what is no finite number is left out.
        """
        if self._drive is not None and math.isfinite(angle):
            self._drive.steered = max(self._drive.steered or 0.0, abs(angle))

    def begin(
        self,
        commands: Commands,
        start: int,
        planned: Planned | None = None,
        prior: GaussianPrior | None = None,
        lead_in: float = 0.0,
    ) -> None:
        """Begin a drive; what was learnt in another one is forgotten.

        Parameters
        ----------
        commands : Commands
            Commands that are played.
        start : int
            Stamp of the first command [ns].
        planned : Planned, optional
            Compared with what is learnt.
        prior : GaussianPrior, optional
            Knowledge before the drive. Parameters that it does not name keep their ranges.
        lead_in : float
            Time until which what is played steers, in place of the commands [s].
        """
        known = box_prior(self._vehicle, prior)
        self._drive = _Drive(commands, start, planned, known, lead_in=lead_in)
        self.began_anew = False

    def play(self, stamp: int, angle: float) -> None:
        """Take a steering motor angle that the driver commands; it counts during the lead-in.

        Parameters
        ----------
        stamp : int
            Stamp of the set-point [ns].
        angle : float
            Left positive [rad].
        """
        drive = self._drive
        if drive is not None and 0.0 <= (time := (stamp - drive.start) * 1e-9) < drive.lead_in:
            drive.led.append((time, angle))

    @property
    def unheard(self) -> float:
        """Time of the lead-in before the first set-point that was heard [s]."""
        drive = self._drive
        if drive is None:
            return 0.0
        return drive.led[0][0] if drive.led else drive.lead_in

    def newest(self, sensor: Sensor) -> int:
        """Return the stamp of the newest sample [ns]; 0 before any.

        Parameters
        ----------
        sensor : Sensor
            Sensor that measured the sample.
        """
        samples = self._samples[sensor]
        return samples[-1][0] if samples else 0

    def abandon(self) -> None:
        """End the drive without a verdict."""
        self._drive = None

    def update(self) -> Moment | None:
        """Return the estimates by all samples of the drive so far; None before they show anything.

        Raises
        ------
        IdentificationError
            If the samples cannot be fitted.
        """
        return None if self._drive is None else self._update(self._drive, math.inf, last=False)

    def complete(self, elapsed: float = math.inf) -> bool:
        """Return whether the samples until the end of the drive have come.

        They have where each sensor told one from then on, or none since the last call: the end may
        be heard before samples that wait in a queue.

        Parameters
        ----------
        elapsed : float
            Since the start event, where it was ended before the commands did [s].
        """
        drive = self._drive
        if drive is None:
            return True
        end = drive.start + round(min(elapsed, drive.commands.duration) * SECOND)
        before = drive.newest
        drive.newest = {sensor: s[-1][0] for sensor, s in self._samples.items() if s}
        return all(at >= end or at == before.get(sensor) for sensor, at in drive.newest.items())

    def end(self, elapsed: float = math.inf) -> tuple[Moment | None, DriveVerdict | None]:
        """End the drive.

        Parameters
        ----------
        elapsed : float
            Since the start event, where it was ended before the commands did [s].

        Returns
        -------
        moment : Moment or None
            From all samples until then; None if they show nothing.
        verdict : DriveVerdict or None
            None where nothing was planned or seen.

        Raises
        ------
        IdentificationError
            If the samples cannot be fitted.
        """
        drive, self._drive = self._drive, None
        moment = None if drive is None else self._update(drive, elapsed, last=True)
        if drive is None or moment is None or drive.planned is None:
            return moment, None
        target = drive.planned.target
        of_target = list(moment.parameters).index(target)
        before, at_end = (float(drive.planned.at(time)[of_target]) for time in (0.0, math.inf))
        estimate = replace(moment.parameters[target], planned=at_end)
        verdict = DriveVerdict(target, estimate, before, ())
        if not verdict.informative:
            verdict = replace(verdict, reasons=tuple(self._reasons(drive, moment)))
        return moment, verdict

    def _begin_anew(self, stamp: int) -> None:
        """Forget what is of a clock's time before it was set back to a stamp [ns]."""
        for samples in self._samples.values():
            while samples and samples[-1][0] >= stamp:
                samples.pop()
        self.began_anew = self.began_anew or self._drive is not None
        self._drive = None

    def _signals(self, drive: "_Drive", end: float) -> dict[Sensor, Signal]:
        signals = {}
        for sensor, samples in self._samples.items():
            if samples:
                stamps, values = zip(*samples, strict=True)
                time = (np.array(stamps) - drive.start) * 1e-9
                rows = np.array(values, dtype=np.float64)
                if sensor is Sensor.HEADING:
                    rows = np.unwrap(rows, axis=0)
                jitter = STAMP_JITTER.get(sensor, 0.0)
                signal = Signal(time, rows, jitter).between(-STANDSTILL, end)
                if sensor not in OF_POSE and measures_nothing(signal.values):
                    continue
                if len(signal.time) >= MIN_POSITIONS:
                    signals[sensor] = signal
        if Sensor.WHEEL_SPEED in signals:
            signals[Sensor.WHEEL_SPEED] = resolved(signals[Sensor.WHEEL_SPEED])
        return signals

    def _reasons(self, drive: "_Drive", moment: Moment) -> Iterator[str]:
        """Why a drive was less informative than planned, as far as it is seen."""
        if drive.planned is None:
            return
        if moment.elapsed < drive.commands.duration - 0.5:
            yield f"ended after {moment.elapsed:.1f} of {drive.commands.duration:.1f} s"
        yield from self._gaps(drive, moment.elapsed)
        commands, signal = drive.commands, self._signals(drive, math.inf)[Sensor.POSITION]
        steps = np.arange(0.0, min(moment.elapsed, commands.duration), CHORD)
        path = [np.interp(steps, signal.time, column) for column in signal.values.T]
        way = float(np.hypot(*np.diff(path)).sum())
        gone = np.cumsum(np.abs(commands.speed[:-1]) * np.diff(commands.time))
        meant = float(np.interp(steps[-1], commands.time[1:], gone))
        if way < SLOWER * meant:
            yield f"slower: {way:.1f} m driven, {meant:.1f} m commanded"
        played = commands.steering_motor_angle[commands.time <= moment.elapsed - REACHED]
        most = float(np.abs(played).max(initial=0.0))
        if drive.steered is not None and drive.steered < CLIPPED * most:
            yield f"steering clipped: {drive.steered:.3f} rad reached, {most:.3f} rad commanded"
        noise = drive.planned.noise
        for sensor, white, rate in (
            (Sensor.POSITION, noise.noise_std, noise.pose_rate),
            (Sensor.HEADING, noise.heading_std, noise.pose_rate),
            (Sensor.YAW_RATE, noise.yaw_rate_std, noise.gyro_rate),
            (Sensor.WHEEL_SPEED, noise.wheel_speed_std, noise.wheel_rate),
        ):
            if white and sensor not in drive.fit.noise:
                yield f"no {sensor.value}"
            elif white:  # samples at another rate: the same information with other noise
                fitted = drive.fit.noise[sensor].white * math.sqrt(rate / drive.fit.rate[sensor])
                if fitted > NOISIER * white:
                    unit = sensor.unit
                    yield f"noise of {sensor.value} {fitted:.2g} {unit}, planned {white:.2g} {unit}"

    def _gaps(self, drive: "_Drive", end: float) -> Iterator[str]:
        """Messages on sensors of which samples of the drive were lost."""
        for sensor, samples in self._samples.items():
            time = np.array([(stamp - drive.start) * 1e-9 for stamp, _ in samples])
            if lost := missing(time, 0.0, end):
                yield f"samples of {sensor.value} are missing for {lost:.1f} of {end:.1f} s"

    def _update(self, drive: "_Drive", end: float, *, last: bool) -> Moment | None:
        """Fit the samples until `end`, from where the last update ended."""
        commands = drive.played
        signals = self._signals(drive, min(end, commands.duration))
        if Sensor.POSITION not in signals:
            return None
        elapsed = float(signals[Sensor.POSITION].time[-1])
        rows = int(np.searchsorted(commands.time, elapsed)) + 1
        if rows < 2:
            return None
        played = (commands.time, commands.steering_motor_angle, commands.speed)
        so_far = Commands(*(column[:rows] for column in played))
        signals = {sensor: s.between(-STANDSTILL, so_far.duration) for sensor, s in signals.items()}
        measured = MeasuredDrive("live", so_far, signals)
        try:
            check_motion(measured)
        except IdentificationError:
            return None
        model = DriveModel(self._vehicle, measured)
        with (
            threadpool_limits(1, user_api="blas"),
            LeastSquares(
                [model], drive.prior.mean, drive.prior.information, Loss.SQUARED
            ) as problem,
        ):
            problem.noise |= {s: level for s, level in drive.fit.noise.items() if s in signals}
            fit = problem.minimise(drive.variables(problem), tolerance=ROUGH)
            if last:
                fit = settled(problem, fit)
            elif elapsed >= LONGER * drive.fit.noise_until or signals.keys() - drive.fit.noise:
                problem.estimate_noise(fit.at)
                fit = problem.minimise(fit.at, tolerance=ROUGH)
                drive.fit.noise_until = elapsed
            covariance = problem.quadratic(fit.at).covariance()
            drive.keep(problem, fit.at)
        if not fit.converged:
            raise IdentificationError("no minimum found: nothing is known from the samples so far")
        std = np.sqrt(np.diag(covariance))[: problem.k] * model.width
        values = model.motion.parameters(fit.at[: problem.k])
        planned: list[float | None] = [None] * problem.k
        if drive.planned is not None:
            planned = drive.planned.at(elapsed).tolist()
        columns = (self._vehicle.unknown, values.tolist(), std.tolist(), planned)
        parameters = {
            name: LiveEstimate(self._vehicle.unit(name), value, own, expected)
            for name, value, own, expected in zip(*columns, strict=True)
        }
        return Moment(elapsed, parameters)
