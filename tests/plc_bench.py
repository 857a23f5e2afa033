"""A PLC called directly, and a host that sends exactly what a test says."""

import dataclasses
import math

from tricycle_bridge.protocol import messages as m
from tricycle_bridge.protocol.boards import HALL_PULSE, TYRE_RADIUS
from tricycle_bridge.protocol.framing import FrameDecoder, encode
from tricycle_bridge.protocol.limits import ANSWER_BUDGET
from tricycle_sim.plc import DriveMeasurement, SteerMeasurement

ENABLE, ESTOP = m.CommandFlag.ENABLE, m.CommandFlag.ESTOP
STANDSTILL = m.CommandFlag.STANDSTILL
SETUP = {m.Board.STEER: m.SteerSetup, m.Board.DRIVE: m.DriveSetup}
MASS = 60.0  # kg at the tread
BRAKING = 1.25  # m/s^2 at full brake
LARGEST_ANSWER = 42  # bytes on the line: STATS
STEER, DRIVE = m.Board.STEER, m.Board.DRIVE
State, Fault, Op, Result = m.PlcState, m.Fault, m.Op, m.Result


class Wheel:
    """A mass on a slope behind a motor and a brake; a test may break its hall sensor.

    `sensed` makes the travel that the sensor sees from the true one, `slope` is the acceleration
    without torque in m/s^2, `towed` a speed that somebody else gives it.
    """

    def __init__(self, *, sensed=lambda travel: travel, slope=0.0, mass=MASS):
        self.sensed, self.slope, self.mass = sensed, slope, mass
        self.towed = None  # m/s
        self.speed = self.travel = self.fastest = 0.0
        self.sensed_speed = 0.0
        self.count = 0  # of the hall sensor ...
        self.edge_at = 0  # us, ... whose newest pulse came then
        self._seen = 0.0  # m

    def move(self, seconds, torque, brake, now_us=0):
        self.speed += seconds * (torque / (TYRE_RADIUS * self.mass) + self.slope)
        braked = seconds * BRAKING * brake
        self.speed = max(self.speed - braked, min(self.speed + braked, 0.0))
        if self.towed is not None:
            self.speed = self.towed
        self.travel += seconds * self.speed
        self.fastest = max(self.fastest, abs(self.speed))
        seen, before = self.sensed(self.travel), self._seen
        self.sensed_speed, self._seen = (seen - before) / seconds, seen
        count = math.floor(seen / HALL_PULSE)
        if count != self.count:
            edge = max(count, self.count) * HALL_PULSE
            self.edge_at = round(now_us - 1e6 * (seen - edge) / self.sensed_speed)
            self.count = count


HALL_SENSORS = {
    "no pulses": lambda travel: 0.0 * travel,
    "direction reads forward": abs,
    "direction reads backward": lambda travel: -abs(travel),
}


class SpeedController:
    """The motor's torque for a set-point, as `motor.c` makes it."""

    def __init__(self):
        self._integral = 0.0  # m, in the direction of the gear
        self._sign = 1

    def torque(self, output, speed, *, reverse):
        if not output.motor_on:
            self._integral = 0.0
            return 0.0
        sign = -1 if reverse else 1
        self._integral *= sign * self._sign
        self._sign = sign
        error = sign * (output.setpoint - speed)
        self._integral += 0.01 * error
        demand = 60.0 * (error + self._integral)
        torque = min(max(demand, -15.0), 35.0)
        self._integral += 0.00067 * (torque - demand)
        return sign * torque


class Bench:
    """A PLC with a host that does exactly what the test says."""

    def __init__(self, plc, *, start_us=0):
        self.plc = plc
        self.board = plc.board
        self.now = start_us  # us
        self.decoder = FrameDecoder(plc.board, host=True)
        self.seq = 0
        self.operation = 0  # number of the last one
        self.answered = 0  # bytes since the last tick
        self.distance = 0.0  # m, of `drive`
        self.frames = []
        self.received = []
        self.state = None
        self.output = None
        is_steer = plc.board is STEER
        self.measurement = SteerMeasurement() if is_steer else DriveMeasurement()

    def send(self, message, *, board=None, session=None, seq=None):
        """Returns the PLC's answers."""
        used = self.seq if seq is None else seq
        session = self.decoder.session if session is None else session
        wire = encode(message, board=board or self.board, seq=used, session=session)
        self.seq = (used + 1) & 0xFF
        data = self.plc.receive(wire, self.now)
        self.answered += len(data)
        return self._take(data)

    def make_room(self):
        """A tick where the next answer would not fit behind those since the last one."""
        if self.answered + LARGEST_ANSWER > ANSWER_BUDGET:
            self.tick()

    def _take(self, data):
        frames = self.decoder.feed(data)
        self.frames += frames
        messages = [frame.message for frame in frames]
        self.received += messages
        for message in messages:
            if isinstance(message, m.SteerState | m.DriveState):
                self.state = message
        return messages

    def tick(self, n=1, **measured):
        """n ticks of 10 ms."""
        self.measurement = dataclasses.replace(self.measurement, **measured)
        for _ in range(n):
            data, self.output = self.plc.tick(self.now, self.measurement)
            self.answered = 0
            self._take(data)
            self.now += 10_000
        return self.state

    def hello(self, session=7):
        self.make_room()
        self.decoder.session = session
        wanted = m.Hello(0, self.board, 99)
        (ack,) = self.send(wanted, session=session)
        return ack

    def command(self, value=0.0, *, flags=ENABLE, limit=0.0, gear=1, brake=0.0, echo=None):
        """value: rad or m/s."""
        echo = m.echo_of(self.now) if echo is None else echo
        if self.board is STEER:
            return self.send(m.SteerCommand(flags, 0, round(value * 1e4), round(limit * 1e3), echo))
        return self.send(
            m.DriveCommand(
                flags, gear, round(value * 1e3), round(limit * 1e3), round(brake * 200), 0, echo
            )
        )

    def drive(self, n, value=0.0, **kwargs):
        """n ticks with a command each; the plant is where its set-point is."""
        for _ in range(n):
            self.command(value, **kwargs)
            self.tick()
            if self.board is STEER:
                self.measurement = SteerMeasurement(self.output.setpoint)
            else:
                self._turn_wheel(self.output.setpoint)

    def roll(self, n, speed):
        """n ticks without commands; the wheel is this fast."""
        for _ in range(n):
            self._turn_wheel(speed)
            self.tick()
        return self.state

    def _turn_wheel(self, speed):
        """The pulses of this speed, and the torque that the change of it takes."""
        torque = MASS * TYRE_RADIUS * (speed - self.measurement.speed) / 0.01
        self.distance += speed * 0.01
        pulses = math.floor(self.distance / HALL_PULSE)
        self.measurement = DriveMeasurement(speed, pulses, torque)

    def control(self, op, *, number=None, echo=None, **kwargs):
        """An operation with the next number, unless the test says another."""
        self.make_room()
        if number is None:
            number = self.operation = (self.operation + 1) & 0xFF
        echo = m.echo_of(self.now) if echo is None else echo
        return self.result(m.Control.of(op, number, echo), **kwargs)

    def set_up(self, **values):
        """SETUP with these values, the others the board's own."""
        self.make_room()
        kind = SETUP[self.board]
        return self.result(kind(**dict.fromkeys(m.layout(kind), 0) | values))

    def result(self, message, **kwargs):
        """Result in the ACK of a message."""
        answers = self.send(message, **kwargs)
        (ack,) = [a for a in answers if isinstance(a, m.Ack)]
        return Result(ack.result)

    def stats(self):
        self.make_room()
        (stats,) = self.send(m.StatsRequest())
        return stats

    def booted(self, **values):
        """After the first tick, a handshake and a SETUP."""
        self.tick()
        self.hello()
        assert self.set_up(**values) is Result.OK
        return self

    def armed(self):
        """Armed, after `booted`."""
        self.drive(5)
        assert self.control(Op.ARM) is Result.OK
        return self
