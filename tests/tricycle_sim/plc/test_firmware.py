"""The firmware's C code against the Python codec, the model's motor, and the UNO's memory."""

import ctypes
import random
import shutil
import subprocess
import zlib
from pathlib import Path

import numpy as np
import pytest
from cobs import cobs

from tricycle_bridge.protocol.framing import DecoderCounters, FrameDecoder, encode
from tricycle_bridge.protocol.messages import (
    MESSAGES,
    Board,
    Hello,
    Ping,
    StatsRequest,
    from_plc,
    layout,
)
from tricycle_core.errors import LinkError
from tricycle_sim.plc import SteerMeasurement
from tricycle_sim.plc.firmware import FirmwareSteerPlc

FIRMWARE = Path(__file__).parents[3] / "firmware"


@pytest.fixture(scope="module")
def steer_library(firmware_libraries):
    return ctypes.CDLL(str(firmware_libraries / "libsteer.so"))


@pytest.fixture(scope="module")
def drive_library(firmware_libraries):
    library = ctypes.CDLL(str(firmware_libraries / "libdrive.so"))
    library.host_motor_new.restype = ctypes.c_void_p
    library.host_motor.restype = ctypes.c_int32
    return library


def _random_message(rng):
    cls = rng.choice(MESSAGES)
    values = []
    for wire in layout(cls).values():
        edge = rng.choice((wire.low, wire.high, 0, rng.randint(wire.low, wire.high)))
        values.append(edge)
    return cls(*values)


def test_random_frames_are_byte_identical(steer_library):
    rng = random.Random(0)
    wire = ctypes.create_string_buffer(64)
    for _ in range(5000):
        message = _random_message(rng)
        board = rng.choice((Board.STEER, Board.DRIVE))
        seq, session = rng.randrange(256), rng.randrange(256)
        python = encode(message, board=board, seq=seq, session=session)
        ver_node = 1 << 5 | from_plc(message.ID) << 4 | board
        payload = message.payload()
        header = bytes([ver_node, message.ID, seq, session])
        length = steer_library.host_encode(wire, header, payload, ctypes.c_uint8(len(payload)))
        assert wire.raw[:length] == python


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
    plc = FirmwareSteerPlc(firmware_libraries / "libsteer.so")
    decoder = FrameDecoder(Board.STEER, host=True)
    decoder.session = 7

    def send(*messages):
        frames = [
            encode(message, board=Board.STEER, seq=seq & 0xFF, session=7)
            for seq, message in enumerate(messages)
        ]
        return decoder.feed(plc.receive(b"".join(frames), 0))

    plc.tick(0, SteerMeasurement())
    fitting = 4096 // 22  # PONG, in the host library's buffer
    hello, *pongs = send(Hello(0, 1, 5), *[Ping(k) for k in range(250)])
    assert len(pongs) == (4096 - 30) // 22 == fitting - 2
    assert [pong.message.token for pong in pongs] == list(range(len(pongs)))
    (stats,) = send(StatsRequest())
    assert stats.message.tx_drop == 250 - len(pongs)
    # what was dropped has used up its number
    assert stats.seq == (hello.seq + 251) & 0xFF


def overlong(payload):
    """A PING of a newer minor version, with a payload of this many bytes."""
    raw = bytes([1 << 5 | Board.STEER, Ping.ID, 0, 7]) + bytes(range(payload))
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


def test_the_motor_controller_is_the_models(drive_library):
    """vehicle-model: Kp 20, Ki 20, back-calculation 0.2, 35 and -15 N m, 250 W, no-load line."""
    motor = ctypes.c_void_p(drive_library.host_motor_new())
    integral, spin, inertia = 0.0, 0.0, 48.3 * 0.335**2  # the vehicle's mass at the tread
    turned = travelled = 0.0
    for tick in range(1500):
        setpoint = np.interp(tick, [0, 300, 800, 1000], [0.0, 3.0, 3.0, 0.0])  # m/s
        travel = round(turned * 335e3) - travelled  # um, as counted
        travelled += travel
        rate = round(spin * 335) / 335  # as measured, in mm/s
        error = setpoint / 0.335 - rate
        integral -= travel * 1e-6 / 0.335  # the way that is missing, the set-point's follows
        demand = 20 * error + 20 * integral
        available = min(35.0, 250.0 / max(rate, 0.5), 9 * (15.5 - rate))
        torque = max(-15.0, min(demand, available))
        integral += 0.01 * (setpoint / 0.335 + 0.2 * (torque - demand))
        found = drive_library.host_motor(
            motor,
            ctypes.c_int32(round(setpoint * 1e5)),
            ctypes.c_int16(round(rate * 335)),
            ctypes.c_int32(int(travel)),
        )
        assert found * 1e-3 == pytest.approx(torque, abs=0.1)
        spin += 0.01 * torque / inertia
        turned += 0.01 * spin
    assert spin == pytest.approx(0.0, abs=0.1)


def _hall(drive_library, position, ticks):
    """Speeds (m/s) and travels (m) that the drive board finds of a wheel at position(time)."""
    times = np.arange(0.0, ticks * 0.01, 2e-5)
    pulses = np.floor(position(times) / 0.015253).astype(int)
    # a pulse is seen where it is passed, forwards or backwards
    passed = np.flatnonzero(np.diff(pulses)) + 1
    counts, edges = (ctypes.c_int32 * ticks)(), (ctypes.c_uint32 * ticks)()
    for k in range(ticks):
        before = passed[times[passed] < (k + 1) * 0.01]
        if len(before):
            counts[k], edges[k] = pulses[before[-1]], round(times[before[-1]] * 1e6)
    speeds, travels = (ctypes.c_int16 * ticks)(), (ctypes.c_int32 * ticks)()
    drive_library.host_hall(counts, edges, ticks, speeds, travels)
    return np.array(speeds) * 1e-3, np.array(travels) * 1e-6


@pytest.mark.parametrize("speed", [0.1, 0.3, 1.0, 4.8, -1.0])
def test_a_steady_speed_from_hall_pulses(drive_library, speed):
    speeds, travels = _hall(drive_library, lambda t: speed * np.minimum(t, 3.0), 400)
    assert speeds[200:299] == pytest.approx(speed, abs=0.01)
    assert travels[200:299] == pytest.approx(0.01 * speed, abs=2e-4)
    assert speeds[350] == 0.0  # it stands from 3 s on


def test_the_speed_of_a_ramp_does_not_lag(drive_library):
    acceleration, ticks = 1.0, 300
    speeds, travels = _hall(drive_library, lambda t: 0.5 * acceleration * t**2, ticks)
    times = 0.01 * np.arange(1, ticks + 1)
    # the mean between two pulses alone would lag by the time from their middle: 50 mm/s at 1 s
    assert speeds[100:] == pytest.approx(acceleration * times[100:], abs=0.015)
    # a pulse is 15 mm; what was travelled is known to a fraction of one
    assert np.cumsum(travels)[30:] == pytest.approx(0.5 * times[30:] ** 2, abs=0.01)


def test_noise_on_the_hall_line_is_an_overspeed_not_an_overflow(drive_library):
    speeds, _ = _hall(drive_library, lambda t: 100.0 * t, 100)
    assert np.all(speeds[5:] > 5.28)


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
