"""A film of a drive that a plant in MuJoCo repeats, rendered without a screen."""

from pathlib import Path

import numpy as np
from matplotlib.colors import to_rgb
from PIL import Image

from parameter_identification.judging.judgement import TimeSeries
from tricycle_bridge.settings import BridgeSettings
from tricycle_cli.reports.static_figures import MEASURED, REFERENCE
from tricycle_core.documents import replacing
from tricycle_core.quantities import Progress
from tricycle_core.timing import TICK
from tricycle_sim.commands import Commands
from tricycle_sim.plants.mujoco_view import MujocoView
from tricycle_sim.rig.emulated import EmulatedRig
from tricycle_sim.rig.host import Host
from tricycle_sim.setpoints import tick_count
from tricycle_sim.vehicle import Vehicle

FRAMES = 10  # per second
COLOURS = 64  # of a frame


def write_rendered_film(
    view: MujocoView,
    commands: Commands,
    series: TimeSeries,
    vehicle: Vehicle,
    settings: BridgeSettings,
    path: Path,
    *,
    speed: float,
    progress: Progress,
) -> float:
    """Drive commands on the plant in MuJoCo, and write a GIF of it beside the recorded drive.

    Parameters
    ----------
    view : MujocoView
        View of a plant that has not been driven yet.
    commands : Commands
        Commands of the recorded drive.
    series : TimeSeries
        Time series of the recorded drive: the measured and the nominal path are drawn on the
        ground.
    vehicle : Vehicle
        Vehicle that the boards are set up for.
    settings : BridgeSettings
        Settings of the bridge between the commands and the emulated boards.
    path : Path
        File that is written.
    speed : float
        Seconds of the drive per second, at least FRAMES times a tick.
    progress : callable
        Called with the number of frames done and of all.

    Returns
    -------
    float
        RMS distance between the repeated and the measured drive [m].

    Raises
    ------
    LinkError
        If the boards stop.
    """
    for colour, x, y in (
        (REFERENCE, series.reference_x, series.reference_y),
        (MEASURED, series.x, series.y),
    ):
        view.add_line(np.stack([x, y], axis=1), to_rgb(colour))
    host = Host(rig := EmulatedRig(vehicle, plant=view.plant), settings)
    host.arm()
    frames: list[Image.Image] = []
    way = [(rig.state.x, rig.state.y)]
    apart, ticks = speed / FRAMES / TICK, tick_count(commands.duration)  # of frames, in ticks
    for tick, _ in enumerate(host.play(commands)):
        if tick >= round(len(frames) * apart):
            frames.append(Image.fromarray(view.picture()).quantize(COLOURS))
        way.append((rig.state.x, rig.state.y))
        progress(tick + 1, ticks)
    first, *others = frames
    with replacing(path) as new:
        first.save(new, save_all=True, append_images=others, duration=1000 // FRAMES, loop=0)
    seen = series.time <= (len(way) - 1) * TICK
    x, y = (
        np.interp(series.time[seen], TICK * np.arange(len(way)), row)
        for row in zip(*way, strict=True)
    )
    return float(np.sqrt(np.mean((x - series.x[seen]) ** 2 + (y - series.y[seen]) ** 2)))
