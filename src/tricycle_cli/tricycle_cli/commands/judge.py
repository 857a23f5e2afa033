"""``tricycle judge``: trajectory errors of recorded drives."""

import argparse
import json
import math
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from parameter_identification.judging.export import PICTURES, ExportFormat, export, plot
from parameter_identification.judging.judgement import Anchor, Datum, Judgement, TopicNames, judge
from tricycle_cli.progress import progress_bar
from tricycle_core.errors import BagError, JudgeError

EXAMPLE = """\
examples:
  tricycle judge out/demo/bags/circle
  tricycle judge out/demo/bags/* --plot judgement.png --export tum
  tricycle judge drive_0.mcap --pose /gnss/fix --datum=46.5197,6.6323 --anchor fit
"""


def add_parser(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        "judge",
        help="trajectory error of recorded drives, from their bags alone",
        description="Trajectory error TE (Eq. 14) of each bag against the reference it holds, "
        "anchored at the mean measured pose of the standstill before the start event. A bag that "
        "cannot be judged is told in one line, and the exit status is 2.",
        epilog=EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = parser.add_argument
    add("bags", metavar="BAG", nargs="+", type=Path, help="rosbag2 directory, .mcap or .db3 file")
    add("--json", action="store_true", help="print one JSON object")
    add("--plot", type=_picture, metavar="FILE", help=f"save a figure ({', '.join(PICTURES)})")
    add(
        "--export",
        choices=[one.value for one in ExportFormat],
        help="save measured and reference trajectory at the points of Eq. 14",
    )
    add("--output", type=Path, default=Path(), metavar="DIR", help="directory for --export")
    add(
        "--anchor",
        choices=[one.value for one in Anchor],
        default=Anchor.STANDSTILL.value,
        help="where the reference starts; fit aligns it with what was measured",
    )
    names = TopicNames()
    add = parser.add_argument_group("bags that were not recorded by this suite").add_argument
    add(
        "--pose",
        default=names.pose,
        metavar="TOPIC",
        help="Odometry, PoseStamped, TransformStamped, TFMessage or NavSatFix (default: odom)",
    )
    add("--reference", default=names.reference, metavar="TOPIC", help="Path with stamps from 0")
    add("--state", default=names.state, metavar="TOPIC", help="DiagnosticStatus of the driver")
    add(
        "--child-frame",
        default=names.child_frame,
        metavar="FRAME",
        help="of the transform to take from TFMessage (default: base_link)",
    )
    add("--datum", type=_datum, metavar="LAT,LON[,ALT]", help="origin for NavSatFix, degrees and m")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Judge the bags and print what was found."""
    topics = TopicNames(
        pose=args.pose,
        reference=args.reference,
        state=args.state,
        child_frame=args.child_frame,
        datum=args.datum,
    )
    judgements, mistakes = [], []
    with progress_bar("judging") as progress:
        for done, bag in enumerate(args.bags, start=1):
            try:
                judgements.append(judge(bag, topics=topics, anchor=Anchor(args.anchor)))
            except (BagError, JudgeError) as error:
                if len(args.bags) == 1:
                    raise
                mistakes.append(error)
            progress(done, len(args.bags))
    for mistake in mistakes:
        print(f"tricycle: {mistake}", file=sys.stderr)
    if not judgements:
        return 2
    if args.json:
        found = [_as_json(judgement) for judgement in judgements]
        print(json.dumps(found[0] if len(args.bags) == 1 else {"bags": found}))
    else:
        _print(judgements)
    if args.export:
        for path in export(judgements, args.output, ExportFormat(args.export)):
            print(f"saved {path}", file=sys.stderr)
    if args.plot:
        plot(judgements, args.plot)
        print(f"saved {args.plot}", file=sys.stderr)
    return 2 if mistakes else 0


def _picture(text: str) -> Path:
    if Path(text).suffix not in PICTURES:
        raise argparse.ArgumentTypeError(f"{text}: needs to end in one of {', '.join(PICTURES)}")
    return Path(text)


def _datum(text: str) -> Datum:
    try:
        return Datum(*(float(number) for number in text.split(",")))
    except (ValueError, TypeError) as error:
        raise argparse.ArgumentTypeError(f"{text!r}: want LAT,LON or LAT,LON,ALT") from error


def _as_json(judgement: Judgement) -> dict[str, Any]:
    """Scalars of a judgement; numbers that are unknown become null."""
    anchor = judgement.anchor_pose
    values: dict[str, Any] = {
        name: value
        for name, value in vars(judgement).items()
        if isinstance(value, float | int | str)
    }
    values |= {
        "bag": str(judgement.bag),
        "te_by_anchor": {name.value: te for name, te in judgement.te_by_anchor.items()},
        "anchor": judgement.anchor.value,
        "anchor_pose": {"x": anchor.x, "y": anchor.y, "heading": anchor.heading},
    }
    return {
        name: None if isinstance(value, float) and math.isnan(value) else value
        for name, value in values.items()
    }


def _print(judgements: list[Judgement]) -> None:
    """One column per bag; the anchors and what they would give below each other."""
    table = Table("", *(judgement.bag.name for judgement in judgements))
    for column in table.columns[1:]:
        column.justify = "right"

    def add(label: str, value: Callable[[Judgement], str]) -> None:
        table.add_row(label, *map(value, judgements))

    add("TE / m²", lambda j: f"{j.te:.5g}" + f" ± {j.te_deviation:.1g}" * (j.te_deviation > 0))
    add("TE less noise / m²", lambda j: f"{j.te_corrected:.5g}")
    add("rms distance / mm", lambda j: f"{1e3 * j.rms:.1f}")
    add("largest distance / mm", lambda j: f"{1e3 * j.max:.1f}")
    add("rms along, across / mm", lambda j: f"{1e3 * j.rms_along:.1f}, {1e3 * j.rms_cross:.1f}")
    add("rms in x, y / mm", lambda j: f"{1e3 * j.rms_x:.1f}, {1e3 * j.rms_y:.1f}")
    add("rms heading / °", lambda j: f"{math.degrees(j.rms_heading):.2f}")
    add("lag, not applied / ms", lambda j: _with_deviation(j.time_offset, j.time_offset_deviation))
    add("position noise / mm", lambda j: f"{1e3 * j.noise:.1f}")
    add("duration / s, points", lambda j: f"{j.duration:.2f}, {j.points}")
    add("anchor", lambda j: j.anchor.value)
    add(
        "anchor / m, m, °",
        lambda j: (
            f"{j.anchor_pose.x:.3f}, {j.anchor_pose.y:.3f}, "
            f"{math.degrees(j.anchor_pose.heading):.2f}"
        ),
    )
    for anchor in Anchor:
        values = (f"{judgement.te_by_anchor[anchor]:.5g}" for judgement in judgements)
        table.add_row(f"TE at anchor {anchor.value} / m²", *values)
    Console().print(table)


def _with_deviation(seconds: float, deviation: float) -> str:
    if math.isnan(seconds):
        return "unknown"
    return f"{1e3 * seconds:.1f} ± {1e3 * deviation:.1f}"
