"""Options that several subcommands have: their declaration, and what they ask for."""

from __future__ import annotations

import sys
from argparse import ArgumentParser, Namespace, _ArgumentGroup
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypedDict

from tricycle_cli.argument_types import at_least, datum
from tricycle_core.documents import check_folder
from tricycle_core.errors import ExcitationError, PlanError

if TYPE_CHECKING:
    from excitation_planner.area.area import Area
    from excitation_planner.design.noise import MeasurementNoise
    from excitation_planner.maneuver import ManeuverFamily
    from parameter_identification.drives.recorded import TopicNames
    from tricycle_sim.vehicle import Vehicle

BAG_HELP = "rosbag2 directory, .mcap or .db3 file, or URL (https://, s3://, sftp://, ...)"
"""Help text of an argument that names a bag."""


def warn_about(vehicle: Vehicle, args: Namespace, area: Area | None = None) -> None:
    """Print what is doubtful about the files of the vehicle and the area, on stderr.

    Of the packaged vehicle `tricycle vehicle check` prints it: those are the paper's numbers.

    Parameters
    ----------
    vehicle : Vehicle
        The one that was loaded.
    args : Namespace
        Parsed arguments, with `vehicle`; with `area` too where there is one.
    area : Area, optional
        The one that was loaded.
    """
    from tricycle_sim.vehicle import warnings_about

    for warning in () if args.vehicle is None else warnings_about(vehicle):
        print(f"warning: {warning}", file=sys.stderr)
    if area is not None and area.doubt:
        print(f"warning: {args.area}: {area.doubt}", file=sys.stderr)


def refuse_given(args: Namespace, names: Iterable[str], why: str) -> None:
    """Refuse options that would have no effect.

    Parameters
    ----------
    args : Namespace
        Parsed arguments; an option that is left out is None, False, or an empty list.
    names : iterable of str
        Names of the options, as in `args`.
    why : str
        Why they have no effect, and what would be right.

    Raises
    ------
    PlanError
        If one is given.
    """
    given = [
        f"--{name.replace('_', '-')}"
        for name in names
        if not ((value := getattr(args, name)) is None or value is False or value == [])
    ]
    if given:
        raise PlanError(f"{', '.join(given)}: {why}")


OF_SIMULATION = "of a simulation, which --vehicle-nodes does not start: leave out one of them"
"""Why an option is refused beside `--vehicle-nodes`."""


def add_overwrite_option(parser: ArgumentParser | _ArgumentGroup) -> None:
    """Declare `--overwrite`, without which no file is replaced.

    Parameters
    ----------
    parser : ArgumentParser or one of its groups
        Parser of a subcommand that writes files.
    """
    parser.add_argument("--overwrite", action="store_true", help="replace files that are there")


def check_output_files(files: Iterable[Path], args: Namespace) -> None:
    """Refuse files that cannot be written or may not be replaced; called before the work.

    Parameters
    ----------
    files : iterable of Path
        Files that will be written.
    args : Namespace
        Parsed arguments, among them that of `add_overwrite_option`.

    Raises
    ------
    ExcitationError
        If a file is there already, without `--overwrite`; if a folder is in its place, or it
        cannot be written where it shall be.
    """
    for file in files:
        if file.is_dir():
            raise ExcitationError(f"{file} is a folder; the name of a file is needed")
        if file.exists() and not args.overwrite:
            raise ExcitationError(f"{file}: exists already; --overwrite replaces it")
        check_folder(file.parent)


def add_range_options(parser: ArgumentParser) -> None:
    """Declare the options that set the search box.

    Parameters
    ----------
    parser : ArgumentParser
        Parser of a subcommand that searches maneuver families.
    """
    parser.add_argument(
        "--range",
        nargs="+",
        default=[],
        metavar="NAME=LOW:HIGH",
        help="search box: ranges of operation parameters in place of the families' own, as "
        "radius=3:12, or circle.speed=0.5:1.5 for one family only",
    )
    parser.add_argument(
        "--ranges", type=Path, metavar="FILE", help="the same from YAML: `radius: [3, 12]`"
    )


def ranges_of(args: Namespace) -> dict[str, tuple[float, float]]:
    """Return the ranges of the options by the name of the operation parameter.

    Parameters
    ----------
    args : Namespace
        Parsed arguments, among them those of `add_range_options`.

    Raises
    ------
    PlanError
        If one is wrong.
    """
    from excitation_planner.maneuver import load_ranges, parse_ranges

    given = {} if args.ranges is None else load_ranges(args.ranges)
    return given | parse_ranges(args.range)


def add_area_option(parser: ArgumentParser) -> None:
    """Declare the option that names the area that plans stay on.

    Parameters
    ----------
    parser : ArgumentParser
        Parser of a subcommand that plans.
    """
    parser.add_argument(
        "--area",
        type=Path,
        metavar="FILE",
        help="YAML file of the ground to stay on, see docs/how-to-area.md (default: no limit)",
    )


def add_lead_in_option(parser: ArgumentParser) -> None:
    """Declare the option of the lead-in.

    Parameters
    ----------
    parser : ArgumentParser
        Parser of a subcommand that plans.
    """
    parser.add_argument(
        "--lead-in",
        type=float,
        metavar="M",
        help="keep the vehicle on its line, closed loop, while it gets up to speed, on so many "
        "metres more than the family's own straight (default: all is open loop)",
    )


def add_vehicle_option(parser: ArgumentParser, what: str = "vehicle YAML") -> None:
    """Declare `--vehicle`.

    Parameters
    ----------
    parser : ArgumentParser
        Parser of the subcommand.
    what : str
        The file's meaning, for the help.
    """
    parser.add_argument(
        "--vehicle", type=Path, metavar="FILE", help=f"{what} (default: the paper's tricycle)"
    )


def add_workers_option(parser: ArgumentParser) -> None:
    """Declare `--workers`.

    Parameters
    ----------
    parser : ArgumentParser
        Parser of a subcommand that reads many bags.
    """
    parser.add_argument(
        "--workers",
        type=at_least(1),
        metavar="N",
        help="processes (default: one per processor)",
    )


def add_noise_options(parser: ArgumentParser, defaults: Mapping[str, MeasurementNoise]) -> None:
    """Declare the options of the measurement noise of a drive.

    Parameters
    ----------
    parser : ArgumentParser
        Parser of a subcommand that plans.
    defaults : mapping of str to MeasurementNoise
        Noise that holds if an option is left out, by condition, for the help.
    """
    from excitation_planner.design.noise import NOISE_FIELDS

    group = parser.add_argument_group(
        "how the drive is measured", "deviations of white noise; where left out, the simulation's"
    )
    for name, (unit, text) in NOISE_FIELDS.items():
        told = ", ".join(f"{when}{getattr(noise, name):g}" for when, noise in defaults.items())
        group.add_argument(
            f"--{name.replace('_', '-')}",
            type=float,
            metavar=unit.upper(),
            help=f"{text} (default: {told})",
        )


def noise_of(args: Namespace, default: MeasurementNoise) -> MeasurementNoise:
    """Return how the drive is measured.

    Parameters
    ----------
    args : Namespace
        Parsed arguments, among them those of `add_noise_options`.
    default : MeasurementNoise
        Values of the options that are left out.
    """
    return replace(default, **_given(args, vars(default)))


def _given(args: Namespace, names: Iterable[str]) -> dict[str, Any]:
    """Values of the options of some names that are given."""
    values = {name: getattr(args, name, None) for name in names}
    return {name: value for name, value in values.items() if value is not None}


def families_of(names: str, args: Namespace) -> tuple[ManeuverFamily, ...]:
    """Return maneuver families with the search box of the options.

    Parameters
    ----------
    names : str
        Names of the families, separated by commas.
    args : Namespace
        Parsed arguments, among them those of `add_range_options`, `add_area_option` and
        `add_lead_in_option`.

    Raises
    ------
    PlanError
        If a name, a range or the lead-in is wrong.
    """
    from excitation_planner.maneuver import family_by_name, with_lead_in, with_ranges

    families = tuple(family_by_name(name) for name in names.split(","))
    searched = not getattr(args, "at", None)  # a given maneuver has the usual speed
    smaller = searched and args.area is not None
    families = with_ranges(families, ranges_of(args), smaller=smaller)
    return families if args.lead_in is None else with_lead_in(families, args.lead_in)


class EffectsAsked(TypedDict):
    """Arguments of `identify` that say which effects are estimated, and how."""

    effects: tuple[str, ...]
    weighed: bool


def add_effects_option(parser: ArgumentParser, *, exceptions: str = "") -> None:
    """Declare the option with the effects that are estimated in addition to the parameters.

    Parameters
    ----------
    parser : ArgumentParser
        Parser of a subcommand that identifies.
    exceptions : str
        Exceptions from the default, for the help.
    """
    parser.add_argument(
        "--effects",
        metavar="weighed|all|none|NAME,NAME",
        help="what the real vehicle has beside the file (steering-zero, wheel-radius, "
        "sensor-forward, …) and is estimated too; weighed: by the average over all their subsets "
        f"(default: weighed{exceptions})",
    )


def effects_asked(args: Namespace, default: str = "weighed") -> EffectsAsked:
    """Return the arguments of `identify` that the option asks for.

    Parameters
    ----------
    args : argparse.Namespace
        Parsed arguments, with those of `add_effects_option`.
    default : str
        Value of the option if it is not given.

    Raises
    ------
    VehicleError
        If a name is none of an effect.
    """
    from tricycle_sim.effects import named_effects

    asked = args.effects or default
    weighed = asked == "weighed"
    return {"effects": named_effects("all" if weighed else asked), "weighed": weighed}


def add_other_vehicle_option(parser: ArgumentParser) -> None:
    """Declare the option that accepts drives whose plan was made for another vehicle.

    Parameters
    ----------
    parser : ArgumentParser
        Parser of a subcommand that identifies.
    """
    parser.add_argument(
        "--other-vehicle",
        action="store_true",
        help="take drives that were planned for another vehicle: as with an earlier file of this "
        "one, of which a constant has been corrected since",
    )


def add_topic_options(parser: ArgumentParser, *, sensors: bool = False) -> None:
    """Declare the options that name the topics of a drive.

    Parameters
    ----------
    parser : ArgumentParser
        Parser of a subcommand that reads recorded drives.
    sensors : bool
        Whether it also reads commands and sensors besides the pose.
    """
    # without defaults: what is not given are the names of TopicNames, or those of a campaign
    add = parser.add_argument_group("topics with other names than this suite's").add_argument
    add(
        "--pose",
        metavar="TOPIC",
        help="Odometry, PoseStamped, TransformStamped, TFMessage or NavSatFix (default: odom)",
    )
    add(
        "--reference", metavar="TOPIC", help="Path with stamps from 0 (default: maneuver/reference)"
    )
    add("--state", metavar="TOPIC", help="DiagnosticStatus of the driver (default: maneuver/state)")
    if sensors:
        add(
            "--commands",
            metavar="TOPIC",
            help="JointTrajectory driven (default: maneuver/commands)",
        )
        add("--imu", metavar="TOPIC", help="Imu; yaw rate, acceleration (default: imu)")
        add(
            "--joint-states",
            metavar="TOPIC",
            help="JointState; speeds of wheels, torque of the motor (default: joint_states)",
        )
    add(
        "--child-frame",
        metavar="FRAME",
        help="of the poses and transforms to take (default: base_link)",
    )
    add("--datum", type=datum, metavar="LAT,LON[,ALT]", help="origin for NavSatFix, degrees and m")


def topics_of(args: Namespace, kept: TopicNames | None = None) -> TopicNames:
    """Return the names of the topics that the options say.

    Parameters
    ----------
    args : Namespace
        Parsed arguments, among them those of `add_topic_options`.
    kept : TopicNames, optional
        Names where no option is given; default: those of the suite.
    """
    from parameter_identification.drives.recorded import TopicNames

    names = kept or TopicNames()
    return replace(names, **_given(args, vars(names)))


def refuse_topics(args: Namespace, why: str) -> None:
    """Refuse the options that name topics, where they would have no effect.

    Parameters
    ----------
    args : Namespace
        Parsed arguments, among them those of `add_topic_options`.
    why : str
        Why they have no effect, and what would be right.

    Raises
    ------
    PlanError
        If one is given.
    """
    from parameter_identification.drives.recorded import TopicNames

    refuse_given(args, [name for name in vars(TopicNames()) if hasattr(args, name)], why)


def describe_later(parser: ArgumentParser, describe: Callable[[], None]) -> None:
    """Have a parser complete its help only when it is shown, as this takes time.

    Parameters
    ----------
    parser : ArgumentParser
        Parser of the subcommand.
    describe : callable
        Completes the help texts of the parser.
    """
    format_help = parser.format_help

    def described() -> str:
        describe()
        return format_help()

    parser.format_help = described  # type: ignore[method-assign]


def search_boxes() -> str:
    """Return the ranges of all families, a line each, for a help text."""
    from excitation_planner.maneuver import family_by_name, family_names, shown_ranges

    lines = [
        f"  {name.replace('_', '-')}: {shown_ranges(family_by_name(name).operation.bounds())}"
        for name in family_names()
    ]
    return "\n".join(["search boxes, in m, m/s, rad and Hz; --range sets others:", *lines, ""])
