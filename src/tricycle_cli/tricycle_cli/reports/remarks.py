"""Remarks that a reader of results needs besides the numbers, one line each."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import chain
from typing import TYPE_CHECKING

from parameter_identification.drives.measured import Input
from tricycle_cli.reports.tables import MOST_MEMBERS
from tricycle_sim.effects import TYRE_ROUNDING

if TYPE_CHECKING:
    from parameter_identification.drives.measured import MeasuredDrive, Sensor
    from parameter_identification.estimation.results import (
        HeldOut,
        Identification,
        IdentifiedParameters,
    )
    from parameter_identification.fleet import Fleet
    from parameter_identification.many_drives import ManyDrives

WORSE = 1.2
"""Error of a prediction, over that of the vehicle file, from which it is told."""

IMPROBABLE = 0.05
"""Probability of an effect below which the remarks only count it."""

FAR = 3.0  # standard deviations of an effect's prior beyond which its size is told as unexpected

OFTEN_OUTSIDE = 0.15  # of a drive more than expected: its samples err together

MUCH_FRICTION = 0.5
"""Share of a tyre's friction above which its stiffness depends on the law that it is given."""

EXACT = 1e-4  # m, noise of positions below which no sensor has told them


def remarks(found: Identification) -> list[str]:
    """Return the remarks that a reader needs besides the table, one line each.

    Parameters
    ----------
    found : Identification
        Result of `identify`.
    """
    from parameter_identification.identified_vehicle import kind_of_drives

    drives = kind_of_drives(found)
    return [
        *_on_the_search(found),
        *_on_what_is_shown(found, drives),
        *_on_the_model(found, drives),
        *_on_effects(found),
        *_on_the_fit(found),
        *(_remark_on_held_out(held, found.level) for held in found.held_out),
    ]


def _on_the_search(found: Identification) -> list[str]:
    """A line where the estimates are no minimum."""
    if found.converged:
        return []
    return [
        "NO minimum was found: the search was given up where its next step would still have moved "
        "the estimates by more than their uncertainty. So none of the parameters is shown. Start "
        "elsewhere (--seed), with fewer effects (--effects), or with other drives"
    ]


def _on_what_is_shown(found: Identification, drives: str) -> list[str]:
    """Remarks on parameters that the drives do not determine, on fixed ones and on range limits."""
    lines = [
        f"not shown by these {drives}: {combination} "
        f"(1σ is {combination.remaining:.0%} of the range's)"
        for combination in found.hidden
    ]
    lines += _taken_as_known(found)
    lines += _not_asked_for(found)
    ends = {
        name: e
        for name, e in (*found.parameters.items(), *found.others.items())
        if min(abs(e.estimate - end) for end in e.range) <= 1e-9 * (e.range[1] - e.range[0])
    }
    if found.converged and not any(found.identifiable.values()):
        cure = "the model contradicts them" if ends else "drive longer, or other maneuvers"
        lines.append(f"these {drives} show none of the parameters: {cure}")
    if ends:
        lines.append(
            f"at an end of the range: {', '.join(ends)}. Widen it in the vehicle file, or the "
            "model lacks something"
        )
    contradicted = [name for name, e in ends.items() if (e.low, e.high) == e.range]
    if found.converged and contradicted:
        lines.append(f"the {drives} contradict the range: {', '.join(contradicted)}; so not shown")
    return lines


def _on_the_model(found: Identification, drives: str) -> list[str]:
    """Remarks on errors of the model, and on those that the intervals count."""
    lines = []
    if not found.white:
        lines.append(
            f"residuals are NOT white ({_least_white(found)}): "
            "the model lacks an effect or a sensor drifts. "
            "The intervals count it as drifting noise; they do not cover a wrong model"
        )
    lines += _contradictions(found, drives)
    if found.missed:
        lines.append(
            f"one of the {drives} is {1e3 * found.missed:.1f} mm (rms) farther than expected from "
            "where the others predict it: the model lacks something. The intervals count how the "
            "estimates change without each of them, and as much again for what errs alike in all"
        )
    if found.deviations:
        names = ", ".join(effect.name for effect in found.deviations)
        lines.append(
            f"the vehicle moves as the model CANNOT ({names}): it has something that no effect "
            "stands for, as tyres that slide or play in the steering. The intervals do not count it"
        )
    counted = any(effect.name == TYRE_ROUNDING for effect in found.effects)
    if found.friction_used > MUCH_FRICTION and not counted:
        lines.append(
            f"a tyre used up to {found.friction_used:.0%} of its friction: stiffnesses are those "
            "of the vehicle file's tyre law. A tyre that bends otherwise may be stiffer at small "
            "slips; the intervals do not count it"
        )
    return lines


def _on_effects(found: Identification) -> list[str]:
    """Effects that probably act, and those that the vehicle file should be corrected for."""
    absent = [e for e in found.effects if e.acts is not None and e.acts < IMPROBABLE]
    lines = [f"effect: {effect}" for effect in found.effects if effect not in absent]
    if held := [e.name for e in found.effects if e.at_an_end]:
        lines.append(
            f"at an end of what is taken for possible: {', '.join(held)}. Correct the constant in "
            "the vehicle file and identify with --other-vehicle, or the model lacks something"
        )
    if far := [e.name for e in found.effects if abs(e.estimate) > FAR * e.prior]:
        lines.append(
            f"farther from the vehicle file than expected: {', '.join(far)}. Measure it, correct "
            "the file and identify with --other-vehicle, or the model lacks something"
        )
    if absent:
        lines.append(
            f"effects: {len(absent)} others, each with a probability below {IMPROBABLE:.0%} "
            "(identification.json)"
        )
    return lines


def _on_the_fit(found: Identification) -> list[str]:
    """Other parameters that fit as well, and outliers."""
    lines = []
    if found.rivals:
        lines.append(
            f"{len(found.rivals)} other set(s) of parameters fit as well; intervals hold them too"
        )
    if found.outliers:
        lines.append(
            f"{found.outliers} samples lie beyond 6 standard deviations: outliers, which count "
            "less with --robust, or what the model lacks"
        )
    return lines


def _least_white(found: Identification) -> str:
    """Return how many residuals are not white, and which is the farthest from white."""
    coloured = found.coloured
    worst = max(coloured, key=lambda test: test.statistic / test.lags)
    count = f"{len(coloured)} of {len(found.whiteness)}"
    if len(coloured) == 1:
        return f"{count}: {worst.drive} {worst.channel}"
    return f"{count}, least of all {worst.drive} {worst.channel}; all: identification.json"


def _contradictions(found: Identification | ManyDrives, drives: str) -> list[str]:
    """A line where drives disagree."""
    from parameter_identification.estimation.interval_correction import (
        CONTRADICTING,
        MIN_DRIVES_FOR_SCATTER,
    )

    if not found.scatter > CONTRADICTING:
        return []
    alike = "and as much again for" if len(found.drives) < MIN_DRIVES_FOR_SCATTER else "not"
    return [
        f"the {drives} contradict each other: they scatter up to {found.scatter:.1f} times as "
        f"much as their noise. The intervals count the scatter, {alike} what errs alike in all"
    ]


def _contradictions_in_vehicles(fleet: Fleet) -> list[str]:
    """A line where drives of vehicles disagree."""
    from parameter_identification.estimation.interval_correction import (
        CONTRADICTING,
        MIN_DRIVES_FOR_SCATTER,
    )

    scatter = {
        name: found.scatter
        for name, found in fleet.vehicles.items()
        if found.scatter > CONTRADICTING
    }
    if not scatter:
        return []
    worst = sorted(scatter, key=lambda name: -scatter[name])
    return [
        f"the drives of {len(scatter)} of {len(fleet.vehicles)} vehicles contradict each other "
        f"({_some(worst)}): they scatter up to {scatter[worst[0]]:.1f} times as much as their "
        f"noise. The intervals count the scatter, and of fewer than {MIN_DRIVES_FOR_SCATTER} "
        "drives as much again for what errs alike in all of a vehicle. One vehicle in a hundred "
        "does so by chance"
    ]


def _some(names: Sequence[str]) -> str:
    """The first names, and whether there are more."""
    more = ", …" if len(names) > MOST_MEMBERS else ""
    return f"{', '.join(names[:MOST_MEMBERS])}{more}"


def _taken_as_known(found: IdentifiedParameters) -> list[str]:
    """Parameters that were held, and what moved as measured."""
    lines = []
    if found.fixed:
        fixed = ", ".join(f"{name} {value:.4g}" for name, value in found.fixed.items())
        lines.append(f"taken as known: {fixed}. An error in them is in no interval")
    if Input.STEERING in found.measured:
        lines.append("the steering moved as measured, not as the file's servo by its commands")
    if Input.SPEED in found.measured:
        lines.append(
            "the wheels turned as measured, not as the file's speed loop by its commands; their "
            "speed tells nothing else"
        )
    return lines


def _not_asked_for(found: IdentifiedParameters) -> list[str]:
    if not found.others:
        return []
    names = ", ".join(found.others)
    return [f"not asked for, but counted as unknown: {names} (--hold-others takes them as known)"]


def _remark_on_held_out(held: HeldOut, level: float) -> str:
    band = ""
    if held.expected is not None and held.inside is not None:
        band = (
            f"; expected {1e3 * held.expected:.1f} mm, inside its {level:.0%} band for "
            f"{held.inside:.0%} of the samples"
        )
        if held.inside < level - OFTEN_OUTSIDE:
            band += "; it is OUTSIDE: this vehicle moves as the model CANNOT"
    if held.rms_estimated > WORSE * held.rms_nominal:
        band += "; WORSE than by the vehicle file"
    return (
        f"{held.name}, not used: predicted to {1e3 * held.rms_estimated:.1f} mm (rms; before "
        f"{1e3 * held.rms_nominal:.1f} mm, noise and drift alone {1e3 * held.noise:.1f} mm{band})"
    )


def remarks_on_many(found: ManyDrives) -> list[str]:
    """Return the remarks that a reader needs besides the table, one line each.

    Parameters
    ----------
    found : ManyDrives
        Result of `identify_many`.
    """
    hidden = [name for name, e in found.parameters.items() if not e.identifiable]
    lines = [f"not shown by these drives: {', '.join(hidden)}"] if hidden else []
    lines += _taken_as_known(found)
    lines += _not_asked_for(found)
    if not found.white:
        lines.append(
            f"residuals of {found.not_white} of {len(found.drives)} drives are NOT white: the "
            "model lacks an effect or a sensor drifts. More drives do not mend that"
        )
    lines += _contradictions(found, "drives")
    lines += [f"effect: {effect}" for effect in found.effects]
    lines += _not_whole([drive.name for drive in found.drives if not drive.complete])
    lines += _not_heard((drive.name, drive.unheard) for drive in found.drives)
    lines += _without_minimum([drive.name for drive in found.drives if not drive.converged])
    hashes = {drive.name: drive.vehicle_hash for drive in found.drives}
    lines += _of_another_file(hashes, found.vehicle_hash)
    lines += [f"left out: {reason}" for reason in found.left_out]
    return lines


def _of_another_file(hashes: Mapping[str, str], here: str) -> list[str]:
    """A line where drives were made with another vehicle file than this one, as far as known."""
    others = {name: known for name, known in hashes.items() if known not in ("", here)}
    if not others:
        return []
    files = _some(sorted(set(others.values())))
    return [
        f"driven with another vehicle file ({files}) than this one ({here}): {len(others)} of the "
        f"drives ({_some(list(others))}). What differs between the files is not checked: a wrong "
        "constant bends the estimates"
    ]


def _not_heard(drives: Iterable[tuple[str, Sequence[Sensor]]]) -> list[str]:
    """A line for each sensor that bags have, but not during their drives."""
    found: dict[Sensor, list[str]] = {}
    for drive, unheard in drives:
        for sensor in unheard:
            found.setdefault(sensor, []).append(drive)
    return [
        f"{sensor.value}: not used of {len(names)} ({_some(names)}), whose bags have samples, but "
        "hardly any of the drive: is its clock that of the poses?"
        for sensor, names in found.items()
    ]


def _without_minimum(drives: Sequence[str]) -> list[str]:
    if not drives:
        return []
    return [
        f"NO minimum was found of what {len(drives)} of the drives have of their own, as their "
        f"start poses ({_some(drives)}): leave them out. Of a vehicle of which these are more than "
        "a tenth of the drives, no parameter is shown"
    ]


def _not_whole(drives: Sequence[str]) -> list[str]:
    if not drives:
        return []
    from trajectory_recorder.bag.reader import NOT_WHOLE

    return [f"bags that are {NOT_WHOLE}; used as far as they go: {len(drives)} ({_some(drives)})"]


def remarks_on_fleet(fleet: Fleet) -> list[str]:
    """Return the remarks that a reader needs besides the table, one line each, outliers first.

    Parameters
    ----------
    fleet : Fleet
        Result of `identify_fleet`.
    """
    from parameter_identification.many_drives import few_coloured

    lines = [
        f"{name}: its drives pull {', '.join(pulled)} beyond the range: none of its parameters is "
        "compared. Widen the range in the vehicle file, or it is a vehicle of another kind"
        for name, pulled in fleet.beyond.items()
    ]
    for name in fleet.odd:
        where = ", ".join(
            f"{'the change of ' * rate}{parameter} ({m.distance:+.1f} σ)"
            for parameter, rate, m in fleet.outliers
            if m.vehicle == name
        )
        lines.append(f"{name} is odd: far from what the others let expect in {where}")
    parameters = next(iter(fleet.vehicles.values())).parameters
    known = {*fleet.populations, *fleet.shared, *fleet.own}
    lines += [f"{name}: too few vehicles show it" for name in parameters if name not in known]
    coloured = [
        f"{name} ({vehicle.not_white} of {len(vehicle.drives)} drives)"
        for name, vehicle in fleet.vehicles.items()
        if not vehicle.white
    ]
    if coloured:
        lines.append(
            f"residuals of {len(coloured)} vehicles are NOT white: the model lacks something, or a "
            f"parameter changes from drive to drive: {_some(coloured)}"
        )
    # a vehicle with few drives cannot show it alone
    if not coloured and not few_coloured(fleet.not_white, fleet.drives):
        lines.append(
            f"residuals of {fleet.not_white} of all {fleet.drives} drives are NOT white: the model "
            "lacks something, or vehicles differ in what they are said to share"
        )
    lines += _contradictions_in_vehicles(fleet)
    lines += _not_whole(
        [
            f"{name}/{drive.name}"
            for name, vehicle in fleet.vehicles.items()
            for drive in vehicle.drives
            if not drive.complete
        ]
    )
    lines += _without_minimum(
        [
            f"{name}/{drive.name}"
            for name, vehicle in fleet.vehicles.items()
            for drive in vehicle.drives
            if not drive.converged
        ]
    )
    lines += _not_heard(
        (f"{name}/{drive.name}", drive.unheard)
        for name, vehicle in fleet.vehicles.items()
        for drive in vehicle.drives
    )
    lines += _of_another_file(
        {
            f"{name}/{drive.name}": drive.vehicle_hash
            for name, vehicle in fleet.vehicles.items()
            for drive in vehicle.drives
        },
        next(iter(fleet.vehicles.values())).vehicle_hash,
    )
    return lines + [f"left out: {reason}" for reason in fleet.left_out]


def remarks_on_drives(
    found: Identification,
    used: Sequence[MeasuredDrive],
    held_out: Sequence[MeasuredDrive],
    *,
    tables: bool,
    redrawn: bool,
) -> Iterator[str]:
    """Yield remarks on the measurements: incomplete bags, unused sensors, and so on.

    Parameters
    ----------
    found : Identification
        Result of `identify`.
    used, held_out : sequence of MeasuredDrive
        Drives to identify from, and drives to predict.
    tables : bool
        Whether some drives are windows of tables.
    redrawn : bool
        Whether the intervals count the error of smoothing the speed.
    """
    from parameter_identification.drives.measured import Sensor
    from parameter_identification.drives.samples import missing
    from parameter_identification.estimation.redrawn import SCATTERED
    from trajectory_recorder.bag.reader import NOT_WHOLE

    for drive in (*used, *held_out):
        if not drive.complete:
            yield f"{drive.name}: its bag is {NOT_WHOLE}; used as far as it goes"
        if drive.recording:  # a window lacks no samples, and is not measured before it begins
            continue
        duration = drive.commands.duration
        for sensor in (Sensor.POSITION, Sensor.YAW_RATE, Sensor.LATERAL_ACCELERATION):
            signal = drive.signals.get(sensor)
            if signal is not None and (lost := missing(signal.time, 0.0, duration)):
                what = f"samples of {sensor.value} are missing for {lost:.1f} of {duration:.1f} s"
                yield f"{drive.name}: {what}"
    yield from _not_heard((drive.name, drive.unheard) for drive in (*used, *held_out))
    hashes = {drive.name: drive.vehicle_hash for drive in (*used, *held_out)}
    yield from _of_another_file(hashes, found.vehicle_hash)
    inputs = {Sensor.WHEEL_SPEED} if Input.SPEED in found.measured else set()
    unused = set(chain.from_iterable(drive.signals for drive in used)) - {*found.noise} - inputs
    for sensor in sorted(unused, key=lambda sensor: sensor.value):
        yield f"{sensor.value}: measured, but not used: the model does not give it"
    white = found.noise[Sensor.POSITION].white
    if tables and white < EXACT:
        yield (
            f"the positions are exact to {1e3 * white:.2g} mm, as of a simulation: the "
            "inputs that are found in a table err by more, and the intervals do "
            "NOT count it; add the noise of a sensor"
        )
    if redrawn or (white > SCATTERED and any(drive.speed is not None for drive in used)):
        counted = (
            "the intervals count, by tables that were simulated and identified in the same way"
            if redrawn
            else "the intervals do NOT count where such tables are used with other drives or an FMU"
        )
        yield (
            f"the positions scatter by {1e3 * white:.2g} mm, and the speed is smoothed from them: "
            f"what that errs by, alike in all windows, {counted}"
        )
