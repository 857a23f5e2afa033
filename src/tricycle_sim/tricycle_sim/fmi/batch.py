"""An FMU in place of our own model: samples that are driven by the same commands."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tricycle_core.errors import PlantError, hint
from tricycle_core.quantities import FloatArray
from tricycle_core.timing import TICK
from tricycle_sim.commands import Commands
from tricycle_sim.fmi.cosimulation import Fmu
from tricycle_sim.fmi.mapping import START, FmuMapping, load_mapping
from tricycle_sim.setpoints import command_rows, delayed, slew_all
from tricycle_sim.vehicle import Vehicle
from tricycle_sim.vehicle.batch import Run

COLUMNS = ("x", "y", "yaw", "vx", "vy", "yaw_rate", "drive_speed")
"""Columns that a batch can record."""


class FmuSimulator:
    """Simulates with an FMU what the vehicle would do.

    It can be sent to another process, which unpacks the FMU for itself.

    Parameters
    ----------
    file : Path
        The mapping; its parameters are named as the vehicle's, or as in `START`.
    """

    def __init__(self, file: Path) -> None:
        self._file = Path(file).absolute()

    def __call__(
        self, vehicle: Vehicle, commands: Commands, *, setpoint: float = 0.0
    ) -> "FmuBatch":
        """Return the batch that simulates samples of a vehicle with the commands.

        Parameters
        ----------
        vehicle : Vehicle
            Vehicle whose unknown parameters are those of the samples; others of the mapping have
            its values.
        commands : Commands
            Commands, each held until the next, slewed as the boards do.
        setpoint : float
            Speed set-point before the first command [m/s].

        Raises
        ------
        PlantError
            If the FMU does not fit the mapping, or the mapping lacks an unknown parameter.
        """
        return FmuBatch(self._file, vehicle, commands, setpoint=setpoint)


class FmuBatch:
    """One sequence of commands for any samples of a vehicle that is an FMU.

    Parameters
    ----------
    file : Path
        Path of the mapping file.
    vehicle : Vehicle
        Vehicle, as in `FmuSimulator`.
    commands : Commands
        Commands, as in `FmuSimulator`.
    setpoint : float
        Speed set-point before the first command [m/s].

    Attributes
    ----------
    time : ndarray of float, shape (t,)
        Times of all columns [s].
    available : tuple of str
        Every column that can be recorded.

    Raises
    ------
    PlantError
        As `FmuSimulator`.
    """

    available = COLUMNS

    def __init__(
        self, file: Path, vehicle: Vehicle, commands: Commands, *, setpoint: float = 0.0
    ) -> None:
        mapping = _checked_mapping(file, vehicle)
        self._steps = mapping.steps_per_tick(file, "a simulation", ("steering", "speed"))
        units = {n: START.get(n) or vehicle.unit(n) for n in mapping.parameters}
        self._vehicle, self._mapping, self._file = vehicle, mapping, file
        self._fmu = Fmu(mapping, units)
        rows = command_rows(commands)
        self.time = np.arange(len(rows) + 1, dtype=np.float64) * TICK
        self._setpoint = setpoint
        self._steering, _ = slew_all(commands.steering_motor_angle[rows], vehicle.steering_slew)
        self._speeds, _ = slew_all(commands.speed[rows], vehicle.acceleration, setpoint)

    def run(
        self,
        parameters: FloatArray,
        columns: Sequence[str],
        *,
        speed: FloatArray | None = None,
        steering_delay: FloatArray | None = None,
        drive_delay: float = 0.0,
        faster: FloatArray | None = None,
        steered: FloatArray | None = None,
    ) -> Run:
        """Simulate samples from the origin, heading +x, to the end of the commands.

        Parameters
        ----------
        parameters : ndarray of float, shape (n, k)
            Values of the vehicle's unknown parameters in its order.
        columns : sequence of str
            Columns to record, from `COLUMNS`.
        speed : ndarray of float, shape (n,), optional
            Speed at which the vehicles roll at the start [m/s], if the mapping has `start_speed`;
            by default they are at rest.
        steering_delay : ndarray of float, shape (n,), optional
            Additional delay of each servo's set-point [s]; default: none.
        drive_delay : float
            Additional delay of the motor's set-point [s].
        faster : ndarray of float, shape (n, t), optional
            Speed that is added to each motor's set-point [m/s]; default: none.
        steered : ndarray of float, shape (n, t), optional
            Angle that is added to each servo's set-point [rad], with the same delay; default: none.

        Raises
        ------
        PlantError
            If the FMU fails, or would have to start with a speed that it does not take.
        """
        speeds = np.zeros(len(parameters)) if speed is None else np.asarray(speed, dtype=float)
        if "start_speed" not in self._mapping.parameters and self._setpoint:
            raise PlantError(f"{self._file}: parameters: lacks start_speed, and the drive has one")
        demands = delayed(self._speeds, drive_delay, self._setpoint)
        later = np.zeros(len(parameters)) if steering_delay is None else steering_delay
        wanted = np.tile(self._steering, (len(parameters), 1))
        if steered is not None:
            wanted += steered[:, :-1]
        pairs = zip(wanted, later, strict=True)
        steering = np.array([delayed(row, float(delay), 0.0) for row, delay in pairs])
        more = np.zeros((len(parameters), len(self.time))) if faster is None else faster
        driven = [
            self._drive(p, float(v), angles, demands + added[:-1])
            for p, v, angles, added in zip(parameters, speeds, steering, more, strict=True)
        ]
        found = {name: np.array([each[name] for each in driven]) for name in columns}
        nothing = np.empty((0, 0))
        angles = np.column_stack([steering[:, :1], steering])
        return Run(found, angles, nothing, self._vehicle.wheels)

    def _drive(
        self, parameters: FloatArray, speed: float, angles: FloatArray, demands: FloatArray
    ) -> dict[str, FloatArray]:
        values = {
            **self._vehicle.values,
            **dict(zip(self._vehicle.unknown, parameters.tolist(), strict=True)),
            "start_speed": speed,
            "start_speed_setpoint": self._setpoint,
        }
        instance = self._fmu.start({name: values[name] for name in self._mapping.parameters})
        try:
            rows = [instance.read()]
            for steering, demand in zip(angles, demands, strict=True):
                instance.set(steering=float(steering), speed=float(demand))
                for _ in range(self._steps):
                    instance.advance()
                rows.append(instance.read())
        finally:
            instance.close()
        return self._columns({name: np.array([row[name] for row in rows]) for name in rows[0]})

    def _columns(self, told: dict[str, FloatArray]) -> dict[str, FloatArray]:
        """Return the columns from the FMU's outputs, each (t,)."""
        heading = np.unwrap(told["heading"])
        c, s = np.cos(heading[0]), np.sin(heading[0])
        dx, dy = told["x"] - told["x"][0], told["y"] - told["y"][0]
        x, y, yaw = c * dx + s * dy, c * dy - s * dx, heading - heading[0]
        rates = [np.gradient(column, TICK) for column in (x, y, yaw)]
        vx = told.get("vx", rates[0] * np.cos(yaw) + rates[1] * np.sin(yaw))
        vy = told.get("vy", rates[1] * np.cos(yaw) - rates[0] * np.sin(yaw))
        return {
            "x": x,
            "y": y,
            "yaw": yaw,
            "vx": vx,
            "vy": vy,
            "yaw_rate": told.get("yaw_rate", rates[2]),
            "drive_speed": told.get("drive_speed", vx / self._vehicle.driven_radius),
        }

    def __del__(self) -> None:
        """Remove what was unpacked."""
        fmu: Any = self.__dict__.get("_fmu")
        if fmu is not None:
            fmu.close()


class FmuFunction:
    """An FMU as the simulator f of `excitation_planner.design_excitation`.

    Parameters
    ----------
    file : Path
        The mapping; the planner's unknown parameters are the vehicle's.
    vehicle : Vehicle
        Vehicle with the unknown parameters in the planner's order.
    commands : callable
        Function from operation parameters x (l,) to `Commands`.
    output : callable
        Function from the columns (`COLUMNS`, each (n, t)) and the operation parameters to outputs
        (n,).

    Raises
    ------
    PlantError
        If the mapping names a constant that the vehicle lacks, or lacks an unknown parameter.
    """

    def __init__(
        self,
        file: Path,
        vehicle: Vehicle,
        commands: Callable[[FloatArray], Commands],
        output: Callable[[dict[str, FloatArray], FloatArray], FloatArray],
    ) -> None:
        _checked_mapping(file, vehicle)  # before the planner starts, not at its first maneuver
        self._simulator, self._vehicle = FmuSimulator(file), vehicle
        self._commands, self._output = commands, output

    def __call__(self, x: FloatArray, parameters: FloatArray) -> FloatArray:
        """Return the outputs (n,) of samples, NaN for those in which the FMU fails.

        Parameters
        ----------
        x : ndarray of float, shape (l,)
            Operation parameters.
        parameters : ndarray of float, shape (n, k)
            Unknown parameters.
        """
        batch = self._simulator(self._vehicle, self._commands(x))
        outputs = np.full(len(parameters), np.nan)
        for i, row in enumerate(parameters):
            try:
                columns = batch.run(row[np.newaxis], COLUMNS).columns
            except PlantError:
                continue
            (outputs[i],) = self._output(columns, x)
        return outputs


def _checked_mapping(file: Path, vehicle: Vehicle) -> FmuMapping:
    """The mapping of a file, whose parameters are the vehicle's and hold all unknown ones."""
    mapping = load_mapping(file)
    known = {*vehicle.values, *START}
    for name in mapping.parameters:
        if name not in known:
            raise PlantError(
                f"{file}: parameters.{name}: {vehicle.name} has no such constant; "
                f"{hint(name, known)}"
            )
    lacking = [name for name in vehicle.unknown if name not in mapping.parameters]
    if lacking:
        verb = "is" if len(lacking) == 1 else "are"
        raise PlantError(
            f"{file}: parameters: lacks {', '.join(lacking)}, which {verb} unknown: name the "
            "FMU's variable of each"
        )
    return mapping
