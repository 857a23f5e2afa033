"""``tricycle judge``: trajectory errors of recorded drives."""

from __future__ import annotations

import argparse
import json
import sys
from contextlib import nullcontext
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

from parameter_identification.judging.export import PICTURES, ExportFormat
from parameter_identification.judging.judgement import Anchor
from tricycle_cli.argument_types import bag_argument, file_ending_in
from tricycle_cli.options import (
    BAG_HELP,
    add_overwrite_option,
    add_topic_options,
    check_output_files,
    refuse_given,
    topics_of,
)
from tricycle_cli.progress import progress_bar
from tricycle_core.documents import check_folder, finite_or_none
from tricycle_core.errors import BagError, JudgeError, message_of
from tricycle_core.optional import check_installed

if TYPE_CHECKING:
    from collections.abc import Sequence

    from parameter_identification.judging.judgement import Judgement

EXAMPLE = """\
examples:
  tricycle judge out/demo/bags/designed
  tricycle judge out/demo/bags/* --plot judgement.png --export tum
  tricycle judge drive_0.mcap --pose /gnss/fix --datum=46.5197,6.6323 --anchor fit
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the subcommand.

    Parameters
    ----------
    parser : argparse.ArgumentParser
        Parser of the subcommand.
    """
    parser.description = (
        "Trajectory error TE (Eq. 14) of each bag against the reference it holds, "
        "anchored at the mean measured pose of the standstill before the start event. A bag that "
        "cannot be judged is reported in one line, and the exit status is 2."
    )
    parser.epilog = EXAMPLE
    add = parser.add_argument
    add("bags", metavar="BAG", nargs="+", type=bag_argument, help=BAG_HELP)
    add("--json", action="store_true", help="print one JSON object")
    add(
        "--plot",
        type=file_ending_in(*PICTURES),
        metavar="FILE",
        help=f"save a figure ({', '.join(PICTURES)})",
    )
    add(
        "--export",
        choices=[one.value for one in ExportFormat],
        help="save measured and reference trajectory at the points of Eq. 14",
    )
    add("--output", type=Path, metavar="DIR", help="directory for --export (default: this one)")
    add_overwrite_option(parser)
    add(
        "--anchor",
        choices=[one.value for one in Anchor],
        default=Anchor.STANDSTILL.value,
        help="where the reference starts; fit aligns it with what was measured",
    )
    add_topic_options(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Judge the bags and print what was found.

    Parameters
    ----------
    args : argparse.Namespace
        Parsed arguments.
    """
    from parameter_identification.judging.export import export, exported_files, plot
    from parameter_identification.judging.judgement import judge

    if args.plot:
        check_installed("matplotlib", "a figure")
        check_output_files([args.plot], args)
    folder = args.output or Path()
    if args.export is None:
        refuse_given(args, ["output"], "only with --export")
    else:
        check_folder(folder)
        files = exported_files(args.bags, folder, ExportFormat(args.export))
        check_output_files(chain.from_iterable(files), args)
    topics = topics_of(args)
    judgements, mistakes = [], []
    # one bag has no parts to tell of, and the bar takes longer to import than to judge it
    bar = progress_bar("judging") if len(args.bags) > 1 else nullcontext(lambda *_: None)
    with bar as progress:
        for done, bag in enumerate(args.bags, start=1):
            try:
                judgements.append(judge(bag, topics=topics, anchor=Anchor(args.anchor)))
            except (BagError, JudgeError, OSError) as error:
                if len(args.bags) == 1:
                    raise
                text = message_of(error)
                mistakes.append(text if str(bag) in text else f"{bag}: {text}")
            progress(done, len(args.bags))
    for mistake in mistakes:
        print(f"tricycle: {mistake}", file=sys.stderr)
    for judgement in judgements:
        if problem := judgement.contradiction:
            frame = "in m, in a frame of which y is to the left of x (REP-103)"
            print(f"{judgement.bag}: {problem}: they must be {frame}", file=sys.stderr)
    if not judgements:
        return 2
    saved: list[Path] = []
    try:  # the reader of a pipe may leave
        if args.export:
            saved += export(judgements, folder, ExportFormat(args.export))
        if args.plot:
            plot(judgements, args.plot)
            saved.append(args.plot)
    finally:  # and a disk be full
        _print(judgements, args)
        for path in saved:
            print(f"saved {path}", file=sys.stderr)
    return 2 if mistakes else 0


def _print(judgements: Sequence[Judgement], args: argparse.Namespace) -> None:
    """Print the table, or JSON: of one bag its object."""
    if args.json:
        documents = [_as_json(judgement) for judgement in judgements]
        print(json.dumps(documents[0] if len(args.bags) == 1 else {"bags": documents}))
    else:
        from tricycle_cli.reports.tables import WIDEST, judgement_table, table_console

        table_console(width=WIDEST).print(judgement_table(judgements))


def _as_json(judgement: Judgement) -> dict[str, Any]:
    """Scalars of a judgement; numbers that are unknown become null."""
    anchor = judgement.anchor_pose
    values: dict[str, Any] = {
        name: value if isinstance(value, str) else finite_or_none(value)
        for name, value in vars(judgement).items()
        if isinstance(value, float | int | str)
    }
    return values | {
        "bag": str(judgement.bag),
        "te_by_anchor": {
            name.value: finite_or_none(te) for name, te in judgement.te_by_anchor.items()
        },
        "anchor": judgement.anchor.value,
        "anchor_pose": {n: finite_or_none(getattr(anchor, n)) for n in ("x", "y", "heading")},
    }
