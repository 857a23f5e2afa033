"""``tricycle judge``: trajectory errors of recorded drives."""

import argparse
import json
import math
import sys
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from parameter_identification.judge import Anchor, Datum, Judgement, Topics, judge
from parameter_identification.judge_export import ExportFormat, export, plot
from tricycle_bringup.progress import progress_bar

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
        "anchored at the mean measured pose of the standstill before the start event.",
        epilog=EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = parser.add_argument
    add("bags", metavar="BAG", nargs="+", type=Path, help="rosbag2 directory, .mcap or .db3 file")
    add("--json", action="store_true", help="print one JSON object")
    add("--plot", type=Path, metavar="FILE", help="save a figure (.png, .pdf, .svg)")
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
    names = Topics()
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
    topics = Topics(
        pose=args.pose,
        reference=args.reference,
        state=args.state,
        child_frame=args.child_frame,
        datum=args.datum,
    )
    judgements = []
    with progress_bar("judging") as progress:
        for done, bag in enumerate(args.bags, start=1):
            judgements.append(judge(bag, topics=topics, anchor=Anchor(args.anchor)))
            progress(done, len(args.bags))
    if args.json:
        found = [_as_json(judgement) for judgement in judgements]
        print(json.dumps(found[0] if len(found) == 1 else {"bags": found}))
    else:
        _print(judgements)
    if args.export:
        for path in export(judgements, args.output, ExportFormat(args.export)):
            print(f"saved {path}", file=sys.stderr)
    if args.plot:
        plot(judgements, args.plot)
        print(f"saved {args.plot}", file=sys.stderr)
    return 0


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
    table = Table("bag", "TE / m²", "less noise", "rms / mm", "max / mm", "along", "across")
    for heading in ("heading / °", "lag / ms", "TE, other anchors / m²"):
        table.add_column(heading)
    for column in table.columns[1:]:
        column.justify = "right"
    for j in judgements:
        others = (f"{a.value} {te:.4g}" for a, te in j.te_by_anchor.items() if a is not j.anchor)
        table.add_row(
            j.bag.name,
            f"{j.te:.5g} ± {j.te_deviation:.1g}",
            f"{j.te_corrected:.5g}",
            *(f"{1e3 * value:.1f}" for value in (j.rms, j.max, j.rms_along, j.rms_cross)),
            f"{math.degrees(j.rms_heading):.2f}",
            f"{1e3 * j.time_offset:.1f} ± {1e3 * j.time_offset_deviation:.1f}",
            ", ".join(others),
        )
    console = Console()
    console.print(table)
    for j in judgements:
        pose = j.anchor_pose
        console.print(
            f"{j.bag.name}: reference anchored at {pose.x:.3f} m, {pose.y:.3f} m, "
            f"{math.degrees(pose.heading):.2f}° ({j.anchor.value}); {j.points} points over "
            f"{j.duration:.2f} s; position noise {1e3 * j.noise:.1f} mm; the lag is not applied",
            highlight=False,
        )
