"""A PLC called directly, and a host that sends exactly what a test says."""

import dataclasses

from tricycle_bridge.protocol import messages as m
from tricycle_bridge.protocol.framing import FrameDecoder, encode
from tricycle_sim.plc import DriveMeasurement, SteerMeasurement

ENABLE, ESTOP = m.CommandFlag.ENABLE, m.CommandFlag.ESTOP
STEER, DRIVE = m.Board.STEER, m.Board.DRIVE
State, Fault, Op, Result = m.PlcState, m.Fault, m.Op, m.Result


class Bench:
    """A PLC with a host that does exactly what the test says."""

    def __init__(self, plc, *, start_us=0):
        self.plc = plc
        self.board = plc.board
        self.now = start_us  # us
        self.decoder = FrameDecoder(plc.board, host=True)
        self.seq = 0
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
        return self._take(self.plc.receive(wire, self.now))

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
            self._take(data)
            self.now += 10_000
        return self.state

    def hello(self, session=7):
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
        """n ticks with a command each; the plant is perfect."""
        for _ in range(n):
            self.command(value, **kwargs)
            self.tick()
            if self.board is STEER:
                self.measurement = SteerMeasurement(self.output.setpoint)
            else:
                self.measurement = DriveMeasurement(self.output.setpoint)

    def control(self, op, **kwargs):
        answers = self.send(m.Control.of(op), **kwargs)
        (ack,) = [a for a in answers if isinstance(a, m.Ack)]
        return Result(ack.result)

    def stats(self):
        (stats,) = self.send(m.StatsRequest())
        return stats

    def booted(self):
        """After the first tick and a handshake."""
        self.tick()
        self.hello()
        return self

    def armed(self):
        """Armed, after `booted`."""
        self.drive(5)
        assert self.control(Op.ARM) is Result.OK
        return self
