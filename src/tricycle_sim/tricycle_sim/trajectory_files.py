"""Trajectories as files: CSV, Parquet, MCAP and a picture.

One row every 10 ms and sample, in SI units, in the columns of `Trajectory`. Where there are several
samples, further columns say which one and with which parameters.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tricycle_core.documents import replacing
from tricycle_core.palette import BLUE, GREEN, ORANGE, VERMILLION
from tricycle_core.quantities import FloatArray
from tricycle_sim.vehicle import Vehicle

if TYPE_CHECKING:
    from tricycle_sim.vehicle.batch import Trajectory

SUFFIXES = (".csv", ".parquet", ".mcap")
PICTURES = (".png", ".pdf", ".svg", ".jpg")


def save_trajectory(
    trajectory: Trajectory,
    path: Path,
    *,
    vehicle: Vehicle,
    parameters: FloatArray | None = None,
) -> int:
    """Write a trajectory in the format of the file's suffix; return the number of rows.

    Parameters
    ----------
    trajectory : Trajectory
        One or several samples.
    path : Path
        Ends in one of `SUFFIXES`; its folder is created. It appears when it is complete.
    vehicle : Vehicle
        Names the parameters.
    parameters : ndarray of float, shape (n, k), optional
        Unknown parameters in which the samples differ; None: one vehicle, no further columns.

    Raises
    ------
    ValueError
        If the suffix is another.
    """
    if path.suffix not in SUFFIXES:
        raise ValueError(f"{path}: needs to end in one of {', '.join(SUFFIXES)}")
    columns = _rows(trajectory, vehicle, parameters)
    with replacing(path) as new:
        match path.suffix:
            case ".csv":
                _save_csv(columns, new)
            case ".parquet":
                _save_parquet(columns, new)
            case _:
                _save_mcap(columns, new, samples=len(trajectory.x))
    return len(columns["time"])


def _rows(
    trajectory: Trajectory, vehicle: Vehicle, parameters: FloatArray | None
) -> dict[str, FloatArray]:
    """Return the columns one sample after the other, each of shape (n * t,)."""
    n, t = trajectory.x.shape
    columns = trajectory.columns()
    columns["time"] = np.tile(columns["time"], (n, 1))
    if parameters is not None:
        columns["sample"] = np.repeat(np.arange(n, dtype=float)[:, np.newaxis], t, axis=1)
        for name, values in zip(vehicle.unknown, parameters.T, strict=True):
            columns[name] = np.repeat(values[:, np.newaxis], t, axis=1)
    return {name: np.ravel(column) for name, column in columns.items()}


def _save_csv(columns: dict[str, FloatArray], path: Path) -> None:
    formats = ["%.2f" if name == "time" else "%.10g" for name in columns]
    table = np.column_stack(list(columns.values()))
    np.savetxt(path, table, fmt=formats, delimiter=",", header=",".join(columns), comments="")


def _save_parquet(columns: dict[str, FloatArray], path: Path) -> None:
    import pyarrow as pa  # type: ignore[import-untyped]
    from pyarrow import parquet

    parquet.write_table(pa.table(columns), path)


def _save_mcap(columns: dict[str, FloatArray], path: Path, *, samples: int) -> None:
    """Write JSON messages, which Foxglove plots as they are; a topic for each sample."""
    from mcap.writer import Writer  # slow to import; other files do not need it

    schema = {
        "type": "object",
        "properties": {name: {"type": "number"} for name in columns},
    }
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(library="tricycle_sim")
        schema_id = writer.register_schema(
            "tricycle_sim.VehicleState", "jsonschema", json.dumps(schema).encode()
        )
        rows = len(columns["time"]) // samples
        table = np.column_stack(list(columns.values())).reshape(samples, rows, -1)
        for sample, states in enumerate(table):
            topic = "vehicle_state" if samples == 1 else f"vehicle_state/{sample}"
            channel_id = writer.register_channel(topic, "json", schema_id)
            for state in states:
                message = dict(zip(columns, state.tolist(), strict=True))
                stamp = round(message["time"] * 1e9)
                writer.add_message(channel_id, stamp, json.dumps(message).encode(), stamp)
        writer.finish()  # type: ignore[no-untyped-call]


def plot_trajectory(trajectory: Trajectory, path: Path) -> None:
    """Save a picture: path from above, speed and steering, yaw rate, wheel loads over time.

    Parameters
    ----------
    trajectory : Trajectory
        One or several samples.
    path : Path
        Ends in one of `PICTURES`; its folder is created.
    """
    import matplotlib as mpl

    mpl.use("Agg")  # files only: works without a display
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(2, 2, figsize=(11, 7), layout="constrained")
    faint = 1.0 if len(trajectory.x) == 1 else 0.4
    above, speed, yaw, loads = axes.ravel()
    above.plot(trajectory.x.T, trajectory.y.T, color=BLUE, alpha=faint)
    above.set(xlabel="x [m]", ylabel="y [m]", aspect="equal", title="centre of mass from above")
    above.set_aspect("equal", adjustable="datalim")
    speed.plot(trajectory.time, trajectory.vx.T, color=BLUE, alpha=faint)
    speed.set(xlabel="time [s]", ylabel="forward speed [m/s]", title="speed and steering")
    steering = speed.twinx()
    steering.plot(trajectory.time, trajectory.steering_motor_angle[0], color=VERMILLION)
    steering.set_ylabel("steering motor angle [rad]", color=VERMILLION)
    yaw.plot(trajectory.time, trajectory.yaw_rate.T, color=BLUE, alpha=faint)
    yaw.set(xlabel="time [s]", ylabel="yaw rate [rad/s]", title="yaw rate")
    colors = (BLUE, VERMILLION, GREEN, ORANGE)
    for (name, load), color in zip(trajectory.load.items(), colors, strict=False):
        lines = loads.plot(trajectory.time, load.T, color=color, alpha=faint)
        lines[0].set_label(name)
    loads.set(xlabel="time [s]", ylabel="load [N]", title="wheel loads")
    loads.legend()
    for axis in axes.ravel():
        axis.grid(visible=True, alpha=0.3)
    try:
        with replacing(path) as new:
            figure.savefig(new, dpi=130)
    finally:
        plt.close(figure)
