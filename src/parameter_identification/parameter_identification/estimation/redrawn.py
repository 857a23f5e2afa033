"""Tables as they would come again: the vehicle of a fit drives them, and the sensors err anew."""

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from parameter_identification.drives.measured import MeasuredDrive, Sensor
from parameter_identification.drives.motion import Motion, motion_of
from parameter_identification.drives.pose_filter import filter_of, low_passed
from parameter_identification.drives.samples import Samples
from parameter_identification.drives.simulated import SensedMotion, SensorNoise
from parameter_identification.drives.smoothing import smooth
from parameter_identification.drives.table import WHEELS, Recording, SteeringMap
from parameter_identification.drives.windows import MEASURED, Windows, select_windows, setpoints_of
from parameter_identification.estimation.bootstrap import Redraw
from parameter_identification.estimation.noise import NoiseLevel
from tricycle_bridge.protocol.limits import MAX_SPEED, STEERING_END_STOP
from tricycle_core.quantities import FloatArray
from tricycle_core.timing import TICK
from tricycle_sim.commands import Commands
from tricycle_sim.vehicle import Vehicle
from tricycle_sim.vehicle.batch import simulate

SCATTERED = 4e-3  # m, from which it matters what a speed errs by that is smoothed from positions


@dataclass(frozen=True, eq=False)
class Table:
    """A recording without set-points of the speed, and how its windows are taken.

    Attributes
    ----------
    recording : Recording
        From `read_recording`.
    vehicle : Vehicle
        Vehicle that drove; its unknown parameters are identified.
    steering : SteeringMap
        From the recording's steering to the angle of the steering motor.
    windows : Windows
        Choice of the windows.
    """

    recording: Recording
    vehicle: Vehicle
    steering: SteeringMap
    windows: Windows

    def drives(self) -> list[MeasuredDrive]:
        """Return its windows.

        Raises
        ------
        IdentificationError
            If there is none.
        """
        found = select_windows(self.recording, self.vehicle, self.steering, self.windows)
        return list(found.drives)

    @cached_property
    def motion(self) -> Motion:
        """Motion of the body, by the poses."""
        return motion_of(self.recording)

    @property
    def scatter(self) -> float:
        """Standard deviation of the noise of a position [m]."""
        return smooth(self.recording.time, self.recording.poses[:, :2]).white

    def redrawn(
        self,
        parameters: Mapping[str, float],
        noise: Mapping[Sensor, NoiseLevel],
        rng: np.random.Generator,
    ) -> "Table":
        """Return the table as a vehicle with such parameters and sensors could have given it.

        It has the speed of this one's poses, and its steering.

        Parameters
        ----------
        parameters : mapping of str to float
            Values of unknown parameters.
        noise : mapping of Sensor to NoiseLevel
            Noise of each sensor; one that is missing measures without errors.
        rng : Generator
            Source of the noise.
        """
        recording, driven = self.recording, self.vehicle.replace(**parameters)
        motion = self.motion
        angle, _ = setpoints_of(recording, motion, driven, self.steering)
        angle = np.clip(angle, -STEERING_END_STOP, STEERING_END_STOP)
        speed = np.clip(motion.speed, -MAX_SPEED, MAX_SPEED)
        # as set-points: what resists in each turn is smoothed away of the speed, and comes again
        commands = Commands(TICK * np.arange(len(angle)), angle, speed)
        seen = SensedMotion.of(
            simulate(driven, commands, speed=speed[0], setpoint=speed[0], threads=1)
        )

        def at(time: FloatArray, column: FloatArray, level: NoiseLevel | None) -> FloatArray:
            exact: FloatArray = np.interp(time - motion.time[0], seen.time, column)
            if level is None:
                return exact
            rate = 1.0 / float(np.median(np.diff(time)))
            errors = SensorNoise(level.white, level.drift, level.drift_time, rate)
            return exact + errors.draw(len(time), rng)

        more = dict(recording.more)
        for name, samples in recording.more.items():
            wheel = name.removeprefix(f"{WHEELS}.")
            if wheel in seen.wheel_speeds:
                sensor, columns = Sensor.WHEEL_SPEEDS, [seen.wheel_speeds[wheel]]
            elif name in MEASURED:
                sensor, columns = MEASURED[name], seen.columns(MEASURED[name])
            else:
                continue
            if columns:
                more[name] = Samples(samples.time, at(samples.time, columns[0], noise.get(sensor)))
        given = recording.steering
        steering = Samples(given.time, self.steering.angle(given.values))
        if recording.steering_measured and seen.steering_motor_angle is not None:
            white = NoiseLevel(smooth(given.time, steering.values[:, np.newaxis]).white)
            steering = Samples(given.time, at(given.time, seen.steering_motor_angle, white))
        time = recording.time
        poses = seen.x, seen.y, seen.heading
        px, py, heading = low_passed(np.array(poses), np.full(3, recording.pose_filter))
        x, y = (at(time, column, noise.get(Sensor.POSITION)) for column in (px, py))
        yaw = None
        if recording.yaw is not None:
            yaw = at(time, heading, noise.get(Sensor.HEADING))
        again = dataclasses.replace(recording, x=x, y=y, yaw=yaw, steering=steering, more=more)
        if yaw is not None and recording.pose_filter > 0.0:
            found = filter_of(time, yaw, more["yaw_rate"])
            again = dataclasses.replace(again, pose_filter=found)
        return dataclasses.replace(self, recording=again, steering=SteeringMap())


def redraw_of(tables: Sequence[Table]) -> Redraw | None:
    """Return a function that gives the windows anew; None where poses tell the speed well.

    Positions that scatter do not, nor do poses that come out of a filter.

    Parameters
    ----------
    tables : sequence of Table
        All tables that are fitted together.
    """
    filtered = any(table.recording.pose_filter > 0.0 for table in tables)
    if not filtered and max(table.scatter for table in tables) < SCATTERED:
        return None

    def redraw(
        parameters: Mapping[str, float],
        noise: Mapping[Sensor, NoiseLevel],
        rng: np.random.Generator,
    ) -> list[MeasuredDrive]:
        again = (table.redrawn(parameters, noise, rng) for table in tables)
        return [drive for table in again for drive in table.drives()]

    return redraw
