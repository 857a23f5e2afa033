"""``tricycle judge``: trajectory errors of recorded drives."""

import argparse
import json
import math
from dataclasses import fields
from enum import Enum
from pathlib import Path

from rich.console import Console
from rich.table import Table

from parameter_identification.judge import Anchor, Datum, Judgement, Topics, judge
from parameter_identification.judge_export import ExportFormat, export, plot
from tricycle_bringup.progress import progress_bar

EXAMPLE = """\
examples:
  tricycle judge out/demo/bags/circle
  tricycle judge out/demo/bags/* --plot judgement.png --export tum
  tricycle judge drive_0.mcap --pose /gnss/fix --datum 46.5197,6.6323 --anchor fit
"""


def add_parser(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        "judge",
        help="trajectory error of recorded drives, from their bags alone",
        description="Trajectory error TE (Eq. 14) of each bag against the reference it holds. The "
        "reference is anchored at the mean measured pose of the standstill before the start event.",
        epilog=EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("bags", metavar="BAG", nargs="+", type=Path, help="rosbag2 directory or file")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument("--plot", type=Path, metavar="FILE", help="save a figure (.png, .pdf, .svg)")
    parser.add_argument(
        "--export",
        type=ExportFormat,
        choices=list(ExportFormat),
        metavar="{tum,csv}",
        help="save measured and reference trajectory at the points of Eq. 14, in --output",
    )
    parser.add_argument("--output", type=Path, default=Path(), metavar="DIR", help="for --export")
    parser.add_argument(
        "--anchor",
        type=Anchor,
        choices=list(Anchor),
        default=Anchor.STANDSTILL,
        metavar="{standstill,start,fit}",
        help="where the reference starts (fit: aligned with what was measured)",
    )
    defaults = Topics()
    topics = parser.add_argument_group("topics of a bag that was not recorded by this suite")
    topics.add_argument("--pose", default=defaults.pose, metavar="TOPIC",
        help="Odometry, PoseStamped, TransformStamped, TFMessage or NavSatFix (default: odom)",
    )  # fmt: skip
    topics.add_argument("--reference", default=defaults.reference, metavar="TOPIC")
    topics.add_argument("--state", default=defaults.state, metavar="TOPIC")
    topics.add_argument("--child-frame", default=defaults.child_frame, metavar="FRAME",
        help="of the transform to take from TFMessage (default: base_link)",
    )  # fmt: skip
    topics.add_argument("--datum", type=_datum, metavar="LAT,LON[,ALT]", help="origin for NavSatFix")
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
        for done, bag in enumerate(args.bags):
            progress(done, len(args.bags))
            judgements.append(judge(bag, topics=topics, anchor=args.anchor))
        progress(len(args.bags), len(args.bags))
    if args.json:
        found = [_as_json(judgement) for judgement in judgements]
        print(json.dumps(found[0] if len(found) == 1 else {"bags": found}))
    else:
        _print(judgements)
    if args.export:
        for path in export(judgements, args.output, args.export):
            print(f"saved {path}", file=_stderr())
    if args.plot:
        plot(judgements, args.plot)
        print(f"saved {args.plot}", file=_stderr())
    return 0
