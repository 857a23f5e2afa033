"""The firmware's C code against the Python codec and wheel check, the model's motor, the UNO."""

import ctypes
import random
import shutil
import subprocess
import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from cobs import cobs
from plc_bench import Bench, Fault, Op, Result, State

from parameter_identification.drives.measured import PULSE_JITTER, Signal
from tricycle_bridge.protocol import messages as m
from tricycle_bridge.protocol.framing import DecoderCounters, FrameDecoder, encode
from tricycle_bridge.protocol.messages import MAJOR, MESSAGES, Board, Ping, from_plc, layout
from tricycle_core.errors import LinkError
from tricycle_sim.plc.firmware import FirmwareDrivePlc, FirmwareSteerPlc
from tricycle_sim.plc.wheel import WheelCheck

FIRMWARE = Path(__file__).parents[3] / "firmware"


@pytest.fixture(scope="module")
def steer_library(firmware_libraries):
    return ctypes.CDLL(str(firmware_libraries / "libsteer.so"))


@pytest.fixture(scope="module")
def drive_library(firmware_libraries):
    library = ctypes.CDLL(str(firmware_libraries / "libdrive.so"))
    library.host_motor_new.restype = ctypes.c_void_p
    library.host_motor.restype = ctypes.c_int32
    library.host_wheel_new.restype = ctypes.c_void_p
    library.host_wheel_fails.restype = ctypes.c_bool
    return library


def _random_message(rng):
    cls = rng.choice(MESSAGES)
    values = []
    for wire in layout(cls).values():
        edge = rng.choice((wire.low, wire.high, 0, rng.randint(wire.low, wire.high)))
        values.append(edge)
    return cls(*values)


@pytest.mark.slow
def test_random_frames_are_byte_identical(steer_library):
    rng = random.Random(0)
    wire = ctypes.create_string_buffer(64)
    for _ in range(5000):
        message = _random_message(rng)
        board = rng.choice((Board.STEER, Board.DRIVE))
        seq, session = rng.randrange(256), rng.randrange(256)
        python = encode(message, board=board, seq=seq, session=session)
        ver_node = MAJOR << 5 | from_plc(message.ID) << 4 | board
        payload = message.payload()
        header = bytes([ver_node, message.ID, seq, session])
        length = steer_library.host_encode(wire, header, payload, ctypes.c_uint8(len(payload)))
        assert wire.raw[:length] == python


@pytest.mark.slow
def test_damaged_streams_are_judged_alike(steer_library):
    rng = random.Random(1)
    pieces = []
    for _ in range(3000):
        frame = encode(_random_message(rng), board=Board.STEER, seq=rng.randrange(256), session=7)
        if rng.random() < 0.5:
            data = bytearray(frame)
            data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
            frame = bytes(data)
        pieces += [frame, rng.randbytes(rng.randrange(20)), b"\0"]
    stream = b"".join(pieces) + b"\0"

    out = ctypes.create_string_buffer(len(stream) * 2)
    counters = (ctypes.c_uint32 * 5)()
    steer_library.host_decode(stream, len(stream), out, counters)
    python = DecoderCounters()
    for host in (True, False):
        decoder = FrameDecoder(Board.STEER, host=host)
        decoder.feed(stream)
        python = decoder.counters
        assert counters[3] == python.cobs
        assert counters[4] == python.crc
    _, ok, length, *_ = counters
    headers_judged = python.ok + python.version + python.unknown + python.session
    # payloads shorter than the table are the state machine's to find
    assert ok - headers_judged == python.length - length
    assert ok > 1000


def test_a_full_line_drops_whole_frames_and_counts_them(firmware_libraries):
    bench = Bench(FirmwareSteerPlc(firmware_libraries / "libsteer.so"))
    bench.tick()
    hello = bench.hello()
    assert hello.nonce == 99
    hello_seq = bench.frames[-1].seq
    bench.tick()
    echo = m.echo_of(bench.now)
    operations = [m.Control.of(op, k, echo) for k in range(200) for op in (Op.ESTOP, Op.CLEAR)]
    # a number for each; every one changes the state: an EVENT of 18 bytes, and an ACK
    controls = [
        m.Control.of(control.op, number & 0xFF, echo) for number, control in enumerate(operations)
    ]
    wires = [
        encode(control, board=Board.STEER, seq=(bench.seq + k) & 0xFF, session=7)
        for k, control in enumerate(controls)
    ]
    bench.seq = (bench.seq + len(wires)) & 0xFF
    before = len(bench.frames)
    data = bench.plc.receive(b"".join(wires), bench.now)
    assert 4096 - 18 < len(data) <= 4096  # the host library's line
    bench.decoder.feed(data)
    received = bench.decoder.counters.ok - before
    assert bench.decoder.counters.rejected == 0
    bench.tick()
    stats = bench.stats()
    assert stats.tx_drop == 2 * len(wires) - received
    # what was dropped has used up its number
    assert bench.frames[-1].seq == (hello_seq + 1 + 2 * len(wires) + 2) & 0xFF


def overlong(payload):
    """A PING of a newer minor version, with a payload of this many bytes."""
    raw = bytes([MAJOR << 5 | Board.STEER, Ping.ID, 0, 7]) + bytes(range(payload))
    return cobs.encode(raw + zlib.crc32(raw).to_bytes(4, "little"))


def test_every_segment_is_judged_alike(steer_library):
    """One byte, few values, the longest that fits, one more, and lengths that wrap a byte."""
    rng = random.Random(2)
    segments = [bytes([value]) for value in range(1, 256)]
    segments += [bytes(rng.choices((1, 2, 3, 4, 9), k=rng.randint(1, 14))) for _ in range(2000)]
    segments += [rng.randbytes(n).replace(b"\0", b"\x02") for n in range(46, 54) for _ in range(20)]
    segments += [b"\x05" * n for n in (254, 255, 256, 257, 300, 305, 306)]
    segments += [overlong(n) for n in (0, 3, 4, 30, 39, 40, 41)]
    for n in range(10):  # raw of every length around the shortest, with a right CRC
        raw = bytes(n)
        segments.append(cobs.encode(raw + zlib.crc32(raw).to_bytes(4, "little")))
    for segment in segments:
        out = ctypes.create_string_buffer(64)
        found = (ctypes.c_uint32 * 5)()
        length = steer_library.host_decode(segment + b"\0", len(segment) + 1, out, found)
        decoder = FrameDecoder(Board.STEER, host=False)
        decoder.session = 7
        decoder.feed(segment + b"\0")
        python = decoder.counters
        judged = python.ok + python.unknown + python.version + python.session
        if found[1] and python.length:  # a payload shorter than the table: a good frame so far
            assert length - 1 < 4 + 4 + 4
            judged, python.length = 1, 0
        assert list(found[1:]) == [judged, python.length, python.cobs, python.crc], segment.hex()
        assert (length > 0) == bool(judged)
        if judged:
            assert out.raw[1:length] == cobs.decode(segment)


def test_the_servo_pulse_is_exact_for_every_setpoint(steer_library):
    steer_library.steer_pulse.restype = ctypes.c_uint16
    for setpoint in range(-78540, 78541, 11):  # 1e-5 rad
        eighths = abs(16 * 500 * setpoint) * 2 + 78540  # rounded to 1/16 us, away from 0
        more = eighths // (2 * 78540)
        pulse = 16 * 1500 + (more if setpoint >= 0 else -more)
        assert steer_library.steer_pulse(ctypes.c_int32(setpoint)) == pulse


class MotorLimits(ctypes.Structure):
    """`struct motor_limits`: 0.1 mm, mN m, mN m, W."""

    _fields_ = [
        (name, ctypes.c_int32) for name in ("tyre_radius", "torque", "regenerative", "power")
    ]


@pytest.mark.parametrize(
    ("radius", "largest", "braking", "power"),
    [(0.335, 35.0, 15.0, 250.0), (0.2, 12.0, 4.0, 100.0), (1.0, 30.0, 15.0, 250.0)],
)
def test_the_motor_controller_is_the_models(drive_library, radius, largest, braking, power):
    """vehicle-model: Kp 20, Ki 20, back-calculation 0.2, the motor's limits, no-load line."""
    limits = MotorLimits(
        round(radius * 1e4), round(largest * 1e3), round(braking * 1e3), round(power)
    )
    motor = ctypes.c_void_p(drive_library.host_motor_new())
    integral, spin, inertia = 0.0, 0.0, 48.3 * radius**2  # the vehicle's mass at the tread
    turned = travelled = 0.0
    for tick in range(2500):
        setpoint = min(3.0, 10 * radius) * np.interp(tick, [0, 300, 800, 1000], [0, 1, 1, 0])  # m/s
        travel = round(turned * radius * 1e6) - travelled  # um, as counted
        travelled += travel
        rate = round(spin * radius * 1e3) / (radius * 1e3)  # as measured, in mm/s
        error = setpoint / radius - rate
        integral -= travel * 1e-6 / radius  # the way that is missing, the set-point's follows
        demand = 20 * error + 20 * integral
        available = min(largest, power / max(rate, 0.5), 9 * (15.5 - rate))
        torque = max(-braking, min(demand, available))
        integral += 0.01 * (setpoint / radius + 0.2 * (torque - demand))
        found = drive_library.host_motor(
            motor,
            ctypes.byref(limits),
            ctypes.c_int32(round(setpoint * 1e5)),
            ctypes.c_int16(round(rate * radius * 1e3)),
            ctypes.c_int32(int(travel)),
        )
        assert found * 1e-3 == pytest.approx(torque, abs=0.1)
        spin += 0.01 * torque / inertia
        turned += 0.01 * spin
    drive_library.host_motor_free(motor)
    assert spin == pytest.approx(0.0, abs=0.1)


def _hall(drive_library, position, ticks, *, pulse=15253, start=10_000):
    """Speeds (m/s) and travels (m) that the drive board finds of a wheel at position(time).

    `start` is the board's clock at the first tick, in us.
    """
    times = np.arange(0.0, min(ticks * 0.01, 5.0), 2e-5)
    pulses = np.floor(position(times) / (pulse * 1e-6)).astype(int)
    # a pulse is seen where it is passed, forwards or backwards
    passed = np.flatnonzero(np.diff(pulses)) + 1
    clock = (np.round(times[passed] * 1e6) + start - 10_000).astype(np.int64) & 0xFFFFFFFF
    newest = np.searchsorted(times[passed], 0.01 * np.arange(1, ticks + 1)) - 1
    seen = newest >= 0
    counts = np.where(seen, pulses[passed][newest], 0).astype(np.int32)
    edges = np.where(seen, clock[newest], start - 10_000).astype(np.uint32)
    speeds, travels = np.zeros(ticks, np.int16), np.zeros(ticks, np.int32)
    drive_library.host_hall(
        ctypes.c_int32(pulse),
        *(ctypes.c_void_p(array.ctypes.data) for array in (counts, edges)),
        ctypes.c_int32(ticks),
        ctypes.c_uint32(start),
        *(ctypes.c_void_p(array.ctypes.data) for array in (speeds, travels)),
    )
    return speeds * 1e-3, travels * 1e-6


@pytest.mark.parametrize("speed", [0.1, 0.3, 1.0, 4.8, -1.0])
def test_a_steady_speed_from_hall_pulses(drive_library, speed):
    speeds, travels = _hall(drive_library, lambda t: speed * np.minimum(t, 3.0), 400)
    assert speeds[200:299] == pytest.approx(speed, abs=0.01)
    assert travels[200:299] == pytest.approx(0.01 * speed, abs=2e-4)
    assert speeds[350] == 0.0  # it stands from 3 s on


def test_a_reversal_passes_the_same_edge_twice(drive_library):
    """A vehicle rolls back over an edge, just so, and is driven on over it: no jump by a pulse."""
    speeds, travels = _hall(drive_library, lambda t: 0.8 * (t - 1.0) ** 2 - 0.01575, 200)
    since = 0.01 * np.arange(1, 201) - 1.0
    assert speeds[60:] == pytest.approx(1.6 * since[60:], abs=0.1)
    way = 0.008 + np.cumsum(travels)  # from the middle between two edges
    assert way[100:] == pytest.approx(0.8 * since[100:] ** 2 - 0.01575, abs=0.016)


def test_a_wheel_that_shows_no_pulse_is_no_faster_than_one_would_be(drive_library):
    speeds, _ = _hall(drive_library, lambda t: 1.0 * np.minimum(t, 2.0), 260)
    since = 0.01 * np.arange(201, 261) - 2.0
    assert np.all(speeds[200:] <= 0.0155 / since + 1e-3)
    assert np.all(np.diff(speeds[200:]) <= 0.0)


@pytest.mark.parametrize("sign", [1, -1])
def test_both_directions_are_alike(drive_library, sign):
    """A wheel that begins in the middle between two edges."""
    way = lambda t: 0.5 * 15253e-6 + sign * 0.5 * t**2  # noqa: E731
    speeds, travels = _hall(drive_library, way, 200)
    assert np.cumsum(travels)[199] == pytest.approx(sign * 2.0, abs=0.005)
    assert speeds[50:] == pytest.approx(sign * 0.01 * np.arange(51, 201), abs=0.02)


@pytest.mark.parametrize("pulse", [1000, 60000])
def test_another_wheel_has_other_pulses(drive_library, pulse):
    speeds, travels = _hall(drive_library, lambda t: 2.0 * t, 300, pulse=pulse)
    assert speeds[100:] == pytest.approx(2.0, abs=0.02)
    assert travels[100:] == pytest.approx(0.02, abs=5e-4)


def test_the_clock_wraps_while_the_wheel_turns(drive_library):
    plain = _hall(drive_library, lambda t: 1.0 * t, 300)
    wrapped = _hall(drive_library, lambda t: 1.0 * t, 300, start=2**32 - 1_500_000)
    assert np.array_equal(plain, wrapped)


def test_a_wheel_at_rest_does_not_move_when_the_clock_comes_round(drive_library):
    """71.6 minutes after its newest pulse its time is now once more."""
    speeds, travels = _hall(drive_library, lambda t: 1.0 * np.minimum(t, 3.0), 2 * 429_497)
    assert not speeds[340:].any()
    assert not travels[340:].any()


def test_the_first_pulse_after_a_long_rest_is_a_slow_one(drive_library):
    """Also where the clock has come round meanwhile, to just after the pulse before."""
    counts = np.array([0] * 10 + [1] * 429_500 + [2] * 3, np.int32)
    ticks = len(counts)
    at = np.flatnonzero(np.diff(counts)) + 1
    edges = np.zeros(ticks, np.uint32)
    for k in at:
        edges[k:] = (int(k) + 1) * 10_000 - 100 & 0xFFFFFFFF
    speeds, travels = np.zeros(ticks, np.int16), np.zeros(ticks, np.int32)
    drive_library.host_hall(
        ctypes.c_int32(15253),
        *(ctypes.c_void_p(array.ctypes.data) for array in (counts, edges)),
        ctypes.c_int32(ticks),
        ctypes.c_uint32(10_000),
        *(ctypes.c_void_p(array.ctypes.data) for array in (speeds, travels)),
    )
    assert 0 < speeds[at[1]] <= 15253 / 300
    assert speeds[at[1] - 1] == 0


def test_the_speed_of_a_ramp_does_not_lag(drive_library):
    acceleration, ticks = 1.0, 300
    speeds, travels = _hall(drive_library, lambda t: 0.5 * acceleration * t**2, ticks)
    times = 0.01 * np.arange(1, ticks + 1)
    # the mean between two pulses alone would lag by the time from their middle: 50 mm/s at 1 s
    assert speeds[100:] == pytest.approx(acceleration * times[100:], abs=0.015)
    # a pulse is 15 mm; what was travelled is known to a fraction of one
    assert np.cumsum(travels)[30:] == pytest.approx(0.5 * times[30:] ** 2, abs=0.01)


def test_the_identification_allows_for_the_errors_of_speeds_from_pulses(drive_library):
    """A vehicle that reaches its speed: the board carries the speed on by the slope before."""

    def way(t):
        return np.where(t < 1.0, 0.75 * t**2, 0.75 + 1.5 * (t - 1.0))

    speeds, _ = _hall(drive_library, way, 400)
    time = 0.01 * np.arange(1, 401)
    told = time > 0.4
    true = np.minimum(1.5 * time, 1.5)[told]
    errors = speeds[told] - true
    signal = Signal(time[told], speeds[told, np.newaxis], PULSE_JITTER)
    allowed = np.hypot(1e-3, signal.stamp_errors(np.gradient(true, time[told])))
    steady = time[told] > 1.05
    assert np.abs(errors[steady]).max() > 8e-3  # the slope is 0 there, and was 1.5 m/s^2
    assert np.all(np.abs(errors) <= 3.0 * allowed)


def test_noise_on_the_hall_line_is_an_overspeed_not_an_overflow(drive_library):
    speeds, _ = _hall(drive_library, lambda t: 100.0 * t, 100)
    assert np.all(speeds[5:] > 5.28)


# ---- the wheel check ----


@dataclass
class Drive:
    """A drive on a slope with a speed controller that sees what is left of the pulses."""

    mass: float
    slope: float  # m/s^2
    dead: float  # s, when the hall wire breaks
    backward: bool  # the direction wire is broken
    setpoint: float

    def rows(self, rng, seconds):
        """Torque, pulses, measured speed and set-point of every tick, as floats of the board."""
        speed = way = torque = measured = integral = 0.0
        seen = ramp = 0
        edge = -1.0
        for tick in range(round(seconds * 100)):
            now = 0.01 * tick
            ramp = min(self.setpoint, ramp + 0.01)
            for _ in range(10):
                speed += 1e-3 * (torque / (self.mass * 0.335) - self.slope)
                way += 1e-3 * speed
            count = seen if now >= self.dead else int(way // 0.015253)
            pulses = (count - seen) * (-1 if self.backward else 1)
            seen = count
            if pulses:
                measured = speed * (-1 if self.backward else 1) + rng.gauss(0.0, 0.02)
                edge = now
            elif now - edge > 0.3:
                measured = 0.0
            error = (ramp - measured) / 0.335
            integral += 0.01 * error
            torque = min(max(20 * (error + integral), -15.0), 35.0)
            yield torque, pulses, round(measured, 3), ramp


def _verdicts(drive_library, drive, rng):
    """First tick in which the wheel check fails, in C and in Python; None: never."""
    values = (0.015253, 0.335, 40.0, 100.0)
    python = WheelCheck(*values)
    c = ctypes.c_void_p(drive_library.host_wheel_new(*map(ctypes.c_float, values)))
    found = [None, None]
    for tick, (torque, pulses, speed, setpoint) in enumerate(drive.rows(rng, 8.0)):
        of_c = drive_library.host_wheel_fails(
            c,
            ctypes.c_float(torque),
            ctypes.c_int32(pulses),
            ctypes.c_float(speed),
            ctypes.c_float(setpoint),
        )
        for k, fails in enumerate((of_c, python.fails(torque, pulses, speed, setpoint))):
            if fails and found[k] is None:
                found[k] = tick
        if None not in found:
            break
    drive_library.host_wheel_free(c)
    return found


@pytest.mark.slow
def test_the_wheel_check_judges_as_the_python_one(drive_library):
    rng = random.Random(3)
    agreed = failed = 0
    total = 300
    for k in range(total):
        drive = Drive(
            mass=rng.uniform(35.0, 110.0),  # the check is told of 40 to 100 kg
            slope=rng.uniform(-0.65, 0.65),
            dead=rng.uniform(0.0, 6.0) if k % 4 == 0 else np.inf,
            backward=k % 4 == 1,
            setpoint=rng.uniform(0.05, 3.0),
        )
        of_c, of_python = _verdicts(drive_library, drive, rng)
        failed += of_python is not None
        both = of_c is not None and of_python is not None
        agreed += abs(of_c - of_python) <= 1 if both else of_c is of_python
    assert agreed >= 0.999 * total
    assert 0.4 * total < failed < 0.8 * total  # both verdicts are there


# ---- the drive board with its own speed loop ----


class PulseBench(Bench):
    """The drive board behind the pulses of a mass that its motor pushes and its brake holds."""

    def __init__(self, plc):
        super().__init__(plc)
        self.speed = self.way = self.torque = 0.0
        self.count = self.edge = 0
        self.dead = False
        self.most = 0.0  # largest torque

    def tick(self, n=1, **measured):
        assert not measured
        for _ in range(n):
            data, self.torque, self.output = self.plc.tick_pulses(self.now, self.count, self.edge)
            self._take(data)
            self.most = max(self.most, self.torque)
            for k in range(100):
                braked = 1e-4 * 25.0 * self.output.brake / 16.2
                self.speed += 1e-4 * self.torque / 16.2
                self.speed = max(self.speed - braked, min(self.speed + braked, 0.0))
                self.way += 1e-4 * self.speed
                if not self.dead and (count := int(self.way // 0.015253)) != self.count:
                    self.count, self.edge = count, self.now + 100 * k
            self.now += 10_000
        return self.state

    def drive(self, n, value=0.0, **kwargs):
        for _ in range(n):
            self.command(value, **kwargs)
            self.tick()


@pytest.fixture
def pulsed(firmware_libraries):
    """Booted, greeted, not set up."""
    bench = PulseBench(FirmwareDrivePlc(firmware_libraries / "libdrive.so"))
    bench.tick()
    bench.hello()
    bench.tick()
    return bench


def _arm(bench, **setup):
    fields = dict.fromkeys(layout(m.DriveSetup), 0) | setup
    assert bench.send(m.DriveSetup(**fields))[0].result == Result.OK
    bench.drive(5)
    echo = m.echo_of(bench.now)
    assert bench.send(m.Control.of(Op.ARM, 1, echo))[-1].result == Result.OK


@pytest.mark.parametrize("gear", [1, 2])
def test_the_board_drives_by_its_pulses(pulsed, gear):
    _arm(pulsed)
    pulsed.drive(500, 1.0, gear=gear)
    sign = 1 if gear == 1 else -1
    assert pulsed.speed == pytest.approx(sign, abs=0.03)
    assert pulsed.state.speed == pytest.approx(1000 * sign, abs=30)
    assert pulsed.state.pwm == pytest.approx(pulsed.torque / 35.0 * 1000, abs=80)
    pulsed.tick(150)  # nobody commands any more
    assert (pulsed.state.state, pulsed.state.faults) == (State.SAFE, Fault.CMD_TIMEOUT)
    assert (pulsed.speed, pulsed.torque, pulsed.output.brake) == (0.0, 0.0, 1.0)


def test_a_dead_hall_wire_takes_the_torque_away(pulsed):
    _arm(pulsed)
    pulsed.drive(300, 1.0)
    pulsed.dead = True
    pulsed.drive(100, 1.0)
    assert (pulsed.state.state, pulsed.state.faults) == (State.FAULT, Fault.PULSES)
    assert (pulsed.torque, pulsed.output.brake) == (0.0, 1.0)


def test_the_motor_keeps_to_the_limits_of_setup(pulsed):
    _arm(pulsed, torque=800, regenerative_torque=321, power=12)
    powers, least = [], 0.0
    for k in range(500):
        pulsed.drive(1, 1.5 if k < 400 else 0.0)
        powers.append(pulsed.torque * pulsed.state.speed * 1e-3 / 0.335)
        least = min(least, pulsed.torque)
    assert pulsed.most == pytest.approx(8.0)
    assert max(powers) == pytest.approx(12.0, abs=0.1)
    assert least == pytest.approx(-3.21)


@pytest.mark.parametrize("gear", [1, 2])
@pytest.mark.parametrize(
    ("torque", "pwm"),
    [(17.5, 500), (-17.5, -500), (0.0527, 2), (0.0523, 1), (-0.0527, -2), (-0.0523, -1),
     (40.0, 1000), (-40.0, -1000), (0.0, 0)],
)  # fmt: skip
def test_the_pwm_is_rounded_and_clamped(firmware_libraries, gear, torque, pwm):
    bench = Bench(FirmwareDrivePlc(firmware_libraries / "libdrive.so")).booted().armed()
    bench.command(1.0, gear=gear)
    assert bench.tick(torque=torque).pwm == pwm


def test_a_smaller_radius_makes_the_controller_of_that_radius(pulsed, firmware_libraries):
    """The gains are of the wheel's angle: the same error of speed is more of a smaller wheel."""
    other = PulseBench(FirmwareDrivePlc(firmware_libraries / "libdrive.so"))
    other.tick()
    other.hello()
    other.tick()
    _arm(pulsed)
    _arm(other, tyre_radius=1675)
    for bench in (pulsed, other):
        bench.drive(3, 1.0)
    assert other.most == pytest.approx(2 * pulsed.most, rel=0.01)


def test_pulses_before_a_reset_do_not_count(pulsed):
    pulsed.count, pulsed.edge = 123_456, pulsed.now - 5
    pulsed.plc.reset()
    state = pulsed.tick()
    assert (state.speed, state.hall_count) == (0, 123_456)


@pytest.mark.parametrize(("low", "high"), [(0, 0), (800, 4200), (0, 4000)])
def test_the_throttle_is_within_its_range(pulsed, drive_library, low, high):
    drive_library.host_throttle.restype = ctypes.c_uint16

    def volts():
        return drive_library.host_throttle(pulsed.plc._host) / 799 * 5.0

    _arm(pulsed, throttle_low=low, throttle_high=high)
    assert volts() == 0.0  # off
    top = (high or 5000) * 1e-3
    largest = 0.0
    for _ in range(150):
        pulsed.drive(1, 3.0)
        share = abs(pulsed.torque) / 35.0
        assert volts() == pytest.approx(low * 1e-3 + share * (top - low * 1e-3), abs=0.02)
        largest = max(largest, share)
    assert largest == 1.0


def test_the_alive_output_toggles_while_the_board_acts(pulsed):
    levels = []

    def follow(n, *command):
        levels.clear()
        for _ in range(n):
            pulsed.drive(1, *command) if command else pulsed.tick()
            levels.append(pulsed.plc.alive)

    follow(4, 0.0)
    assert not any(levels)
    _arm(pulsed)
    follow(6, 1.0)
    assert levels == [True, False] * 3
    pulsed.drive(100, 1.0)
    pulsed.command(1.0, flags=0)
    follow(4)
    assert pulsed.state.state == State.STOPPING
    assert levels in ([True, False] * 2, [False, True] * 2)
    pulsed.send(m.Control.of(Op.ESTOP))
    follow(4)
    assert not any(levels)


def test_a_library_that_was_not_built_is_named(tmp_path):
    with pytest.raises(LinkError, match=r"libsteer.so does not exist: build it with"):
        FirmwareSteerPlc(tmp_path / "libsteer.so")


@pytest.mark.slow
def test_the_firmware_fits_the_uno_without_a_warning(tmp_path):
    if shutil.which("avr-gcc") is None:
        pytest.skip("no avr-gcc")
    done = subprocess.run(
        ["make", "-s", "-C", FIRMWARE, "avr", f"BUILD={tmp_path}"],
        check=True, capture_output=True, text=True,
    )  # fmt: skip
    assert [line.split(":")[0] for line in done.stdout.splitlines()] == ["steer", "drive"]
    assert done.stderr == ""
    assert (tmp_path / "steer.hex").exists()
