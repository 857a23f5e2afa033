"""Results of a campaign as JSON, as a table for the terminal and as a figure."""

import dataclasses
import math
from collections.abc import Mapping
from contextlib import suppress
from itertools import cycle, zip_longest
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from rich.box import SIMPLE_HEAD
from rich.table import Table

from excitation_planner.area.area import Area
from parameter_identification.drives.reader import read_drive, read_way_back
from parameter_identification.estimation.intervals import half_width
from tricycle_cli.campaign.cycle import Campaign, Knowledge
from tricycle_cli.campaign.request import WAY_BACK
from tricycle_cli.reports.static_figures import draw_borders
from tricycle_core.documents import replacing
from tricycle_core.errors import BagError, JudgeError
from tricycle_core.palette import BLUE, GREEN, ORANGE, PURPLE, SKY_BLUE, VERMILLION

FAMILIES = (BLUE, GREEN, ORANGE, PURPLE, SKY_BLUE)  # on the yard


def campaign_report(campaign: Campaign, truth: Mapping[str, float] | None = None) -> dict[str, Any]:
    """Return the campaign so far as JSON values.

    Parameters
    ----------
    campaign : Campaign
        Campaign to report.
    truth : mapping of str to float, optional
        Hidden true values, where they are known.
    """
    known, missing = campaign.known(), campaign.missing()
    return {
        "targets": {
            name: {
                "estimate": known[name].estimate,
                "standard_deviation": known[name].std,
                "half_width": known[name].share if known[name].estimate else None,
                "within_tolerance": name not in missing,
                **({"truth": truth[name]} if truth else {}),
            }
            for name in campaign.request.targets
        },
        "tolerance": campaign.request.tolerance,
        "drives": len(campaign.steps),
        "driving_seconds": sum(step.duration for step in campaign.steps if step.driven),
        "steps": [
            {
                "target": step.target,
                "maneuver": step.maneuver,
                "operation": dict(step.operation),
                "plan": step.plan,
                "bag": step.bag,
                "predicted_std": {
                    name: step.predicted_std[name] for name in campaign.request.targets
                },
                "known": {
                    name: dataclasses.asdict(campaign.known(number)[name])
                    for name in campaign.request.targets
                },
            }
            for number, step in enumerate(campaign.steps, start=1)
        ],
    }


def campaign_table(campaign: Campaign, truth: Mapping[str, float] | None) -> Table:
    """Return estimate and interval of each target, a row per drive.

    Parameters
    ----------
    campaign : Campaign
        Campaign to show.
    truth : mapping of str to float, optional
        Hidden true values, where they are known.
    """
    wanted = f"wanted: ± {100.0 * campaign.request.tolerance:g} %"
    table = Table(
        title=f"estimates ± 1.96σ (half a 95 % interval; ranges as if uniform), {wanted}",
        caption="expected: if no effects act; the estimates reckon with them"
        if campaign.request.effects
        else None,
        box=SIMPLE_HEAD,
        pad_edge=False,
    )
    # a row per drive and target: the names are what one reads, and stay whole at 80 columns
    for heading in ("after", "target", "estimate", "expected"):
        right = heading in ("estimate", "expected")
        table.add_column(heading, justify="right" if right else "left", no_wrap=True)
    for number in range(len(campaign.steps) + 1):
        known = campaign.known(number)
        step = campaign.steps[number - 1] if number else None
        after = f"{number}: {step.maneuver}" if step else "nothing: the ranges"
        for name in campaign.request.targets:
            expected = step and Knowledge(known[name].estimate, step.predicted_std[name]).share
            table.add_row(
                after,
                name,
                f"{known[name].estimate:.5g} ± {known[name].share:.2%}",
                "" if expected is None else f"± {expected:.2%}",
            )
            after = ""
    if truth is not None:
        for after, name in zip_longest(["hidden truth"], campaign.request.targets, fillvalue=""):
            table.add_row(after, name, f"{truth[name]:.5g}", "")
    return table


def plot_yard(campaign: Campaign, area: Area, path: Path) -> None:
    """Draw measured drives and ways back on the area, to scale.

    Parameters
    ----------
    campaign : Campaign
        Campaign to show; its bags are read.
    area : Area
        Area on which it was driven.
    path : Path
        Image to be written; its suffix gives the format.
    """
    figure = Figure(figsize=(7.2, 8.4), layout="constrained")
    axes = figure.subplots()
    draw_borders(axes, area)
    names = [family.name for family in campaign.request.families]
    families = dict(zip(names, cycle(FAMILIES), strict=False))
    returned, starts = False, list[tuple[tuple[float, float], list[str]]]()
    near = 0.03 * np.ptp(area.keep_in, axis=0).max()  # labels would lie on each other
    for number, step in enumerate(campaign.steps, start=1):
        if not step.driven:
            continue
        bag = campaign.folder / step.bag
        poses = read_drive(bag, topics=campaign.topics, sensors=False).driven
        color = families[step.maneuver]
        for way in (bag, campaign.folder / WAY_BACK / bag.name):
            back = None
            if way.exists():
                with suppress(BagError, JudgeError):  # one that failed
                    back = read_way_back(way, topics=campaign.topics)
            if back is not None:
                thin = max(1, len(back.x) // 300)  # the noise of all poses would fill the dashes
                axes.plot(back.x[::thin], back.y[::thin], "--", color="0.6", linewidth=0.8)
                returned = True
        axes.plot(poses.x, poses.y, color=color, linewidth=1.0)
        axes.plot(poses.x[0], poses.y[0], "o", color=color)
        start = (float(poses.x[0]), float(poses.y[0]))
        for place, numbers in starts:
            if math.dist(place, start) < near:
                numbers.append(str(number))
                break
        else:
            starts.append((start, [str(number)]))
    for place, numbers in starts:
        axes.annotate(", ".join(numbers), place, xytext=(5, 5), textcoords="offset points")
    driven = {step.maneuver for step in campaign.steps if step.driven}
    for name, color in families.items():
        if name in driven:
            axes.plot([], [], "o-", color=color, label=f"{name.replace('_', ' ')}, from its start")
    if returned:
        axes.plot([], [], "--", color="0.6", linewidth=0.8, label="way back to a start")
    axes.set_xlabel(f"x in {area.frame} / m", parse_math=False)
    axes.set_ylabel(f"y in {area.frame} / m", parse_math=False)
    axes.set_aspect("equal")
    axes.grid(alpha=0.3)
    axes.legend(
        fontsize="small", loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2, columnspacing=1.0
    )
    with replacing(path) as file:
        figure.savefig(file, dpi=150, bbox_inches="tight")


def plot_campaign(campaign: Campaign, truth: Mapping[str, float] | None, path: Path) -> None:
    """Plot the estimate of each target by drive, and the half width of its 95 % interval.

    Parameters
    ----------
    campaign : Campaign
        Campaign to show.
    truth : mapping of str to float, optional
        Hidden true values, where they are known.
    path : Path
        Image to be written; its suffix gives the format.
    """
    targets, steps = campaign.request.targets, campaign.steps
    figure = Figure(figsize=(5.6 * len(targets), 7.6), layout="constrained")
    axes = figure.subplots(2, len(targets), squeeze=False, sharex=True)
    drives = range(len(steps) + 1)
    for name, above, below in zip(targets, *axes, strict=True):
        known = [campaign.known(number)[name] for number in drives]
        above.errorbar(
            drives, [k.estimate for k in known], yerr=[half_width() * k.std for k in known],
            fmt="o", capsize=4, color=BLUE, label="estimate, 95 % interval",
        )  # fmt: skip
        if truth is not None:
            above.axhline(truth[name], color="0.2", linestyle="--", label="hidden truth")
        above.set_title(name.replace("_", " "))
        below.plot(drives, [100.0 * k.share for k in known], "o-", color=BLUE, label="came")
        expected = [
            100.0 * Knowledge(k.estimate, step.predicted_std[name]).share
            for step, k in zip(steps, known[1:], strict=True)
        ]
        below.plot(drives[1:], expected, "x", color=VERMILLION, label="expected when planned")
        below.axhline(100.0 * campaign.request.tolerance, color="0.2", label="tolerance")
        below.set_yscale("log")
        names = (f"{n}: {s.maneuver.replace('_', ' ')}" for n, s in enumerate(steps, start=1))
        slanted = {"rotation": 45.0, "ha": "right", "rotation_mode": "anchor"}
        below.set_xticks(drives, ["the range", *names], **slanted)
        for axis in (above, below):
            axis.grid(alpha=0.3)
            axis.legend(fontsize="small")
    axes[0, 0].set_ylabel("value in the unit of the vehicle file")
    axes[1, 0].set_ylabel("half width / % of the estimate")
    with replacing(path) as file:
        figure.savefig(file, dpi=150)
