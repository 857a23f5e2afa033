"""The tables of docs/protocol.md against the Python code, the firmware in C, and what PLCs do.

A changed number in the document, or a change of either implementation, fails here.
"""

import itertools
import re
import shutil
import struct
import subprocess
import zlib
from pathlib import Path

import pytest
from cobs import cobs
from plc_bench import DRIVE, ENABLE, ESTOP, SETUP, STANDSTILL, STEER, Fault, Op, Result, State

from tricycle_bridge import arming
from tricycle_bridge.commands import command_stream
from tricycle_bridge.plc_link import handshake, link, operations
from tricycle_bridge.protocol import boards, limits
from tricycle_bridge.protocol import messages as m
from tricycle_bridge.protocol.framing import FrameDecoder, encode
from tricycle_core.timing import TICK

ROOT = Path(__file__).parents[3]
DOCUMENT = (ROOT / "docs" / "protocol.md").read_text()
BOARDS = {"steer": [STEER], "drive": [DRIVE], "both": [STEER, DRIVE]}


def section(heading):
    """Text under a heading, up to the next one."""
    found = re.search(rf"^##+ {re.escape(heading)}.*?$(.*?)(?=^##|\Z)", DOCUMENT, re.M | re.S)
    return found[1]


def tables(text):
    """Rows of each table, as lists of cells without backquotes; the first row is the heading."""
    for lines in re.findall(r"(?:^\|.*\|$\n?)+", text, re.M):
        rows = [
            [cell.strip().replace("`", "") for cell in line.strip()[1:-1].split("|")]
            for line in lines.splitlines()
        ]
        yield [row for row in rows if set("".join(row)) - set("-")]


def table(heading, *columns):
    """Rows below the heading row of the table with these columns first."""
    for head, *rows in tables(section(heading)):
        if head[: len(columns)] == list(columns):
            return rows
    raise AssertionError(f"{heading}: no table with {columns}")


def number(text):
    """The number at the beginning of a cell."""
    return float(re.match(r"[\d.]+", text)[0])


# ---- the generated tables and the C header ----

CLASSES = {cls.__name__: cls for cls in m.MESSAGES}
MESSAGE_ROWS = table("2 Messages", "id", "message", "from", "board", "bytes", "in Python")
FIELDS = {
    name: [row[:2] for row in next(tables(text))[1:]]
    for name, text in re.findall(
        r"<!-- table: ([A-Z]\w+) -->\n(.*?)<!-- end -->", DOCUMENT, re.DOTALL
    )
}


def test_every_message_is_in_the_document():
    described = [
        (int(code, 16), sender == "PLC", m.Board[board.upper()] if board != "both" else m.Board.ANY)
        for code, _, sender, board, *_ in MESSAGE_ROWS
    ]
    assert described == [(cls.ID, m.from_plc(cls.ID), cls.BOARD) for cls in m.MESSAGES]
    assert [row[5] for row in MESSAGE_ROWS] == list(CLASSES)
    assert set(FIELDS) | {"LimitsRequest", "StatsRequest"} == set(CLASSES)


@pytest.mark.parametrize("name", CLASSES)
def test_the_layout_of_a_message_is_that_of_the_code(name):
    fields = m.layout(CLASSES[name])
    assert FIELDS.get(name, []) == [[field, wire.name] for field, wire in fields.items()]
    (size,) = [int(row[4]) for row in MESSAGE_ROWS if row[5] == name]
    assert size == sum(wire.size for wire in fields.values())


@pytest.fixture(scope="module")
def macros():
    """Macros of the firmware's header, as the preprocessor sees them."""
    if shutil.which("cc") is None:
        pytest.skip("no C compiler")
    header = ROOT / "firmware" / "messages.h"
    done = subprocess.run(
        ["cc", "-E", "-dM", header], check=True, capture_output=True, text=True
    )  # fmt: skip
    macros = re.findall(r"^#define (\w+) (0x[0-9A-F]+|\d+)$", done.stdout, re.MULTILINE)
    return {name: int(value, 0) for name, value in macros}


def c_name(name):
    return re.sub(r"(?<!^)(?=[A-Z])", "_", name).lower()


@pytest.mark.parametrize("row", MESSAGE_ROWS, ids=lambda row: row[5])
def test_the_layout_of_a_message_is_that_of_the_firmware(row, macros):
    code, size, name = int(row[0], 16), int(row[4]), c_name(row[5])
    assert macros[f"ID_{name.upper()}"] == code
    assert macros[f"SIZE_{name.upper()}"] == size
    header = (ROOT / "firmware" / "messages.h").read_text()
    struct = re.search(rf"^struct {name} {{\n(.*?)}}", header, re.MULTILINE | re.DOTALL)
    members = re.findall(r"\t(u?)int(\d+)_t (\w+);", struct[1] if struct else "")
    assert [[field, f"{'u' if u else 'i'}{bits}"] for u, bits, field in members] == FIELDS.get(
        row[5], []
    )


ENUMERATIONS = [
    ("5.1 States", "value", "state", m.PlcState),
    ("2.3 CTRL", "value", "op", m.Op),
    ("2.9 ACK", "value", "result", m.Result),
    ("2.6 DRIVE_CMD", "value", "gear", m.Gear),
    ("2.7 HELLO_ACK", "value", "reset cause", m.ResetCause),
    ("2.13 EVENT", "value", "event code", m.EventCode),
    ("2.5 STEER_CMD", "bit", "command flag", m.CommandFlag),
    ("2.14 STEER_STATE", "bit", "state flag", m.StateFlag),
    ("2.7 HELLO_ACK", "bit", "capability", m.Capability),
    ("5.7 Faults", "bit", "fault", m.Fault),
]


@pytest.mark.parametrize(("heading", "first", "what", "kind"), ENUMERATIONS)
def test_the_values_of_a_field_are_those_of_both_codes(heading, first, what, kind, macros):
    rows = table(heading, first, what)
    described = {name: 1 << int(n) if first == "bit" else int(n) for n, name, *_ in rows}
    assert described == {member.name: member.value for member in kind}
    prefix = c_name(kind.__name__).upper()
    assert described == {name: macros[f"{prefix}_{name}"] for name in described}


# ---- frames ----


def numbers(text):
    return [int(found, 0) for found in re.findall(r"0x[0-9A-F]+|\d+", text)]


def test_the_header_is_the_one_described():
    rows = table("1.2 Frame", "offset", "field", "meaning")
    assert [(int(offset), field) for offset, field, _ in rows] == [
        (0, "ver_node"), (1, "id"), (2, "seq"), (3, "sess"),
    ]  # fmt: skip
    bits = [7, 5, m.MAJOR, 4, 0, 1, 3, 0, STEER, DRIVE, m.Board.ANY]
    assert numbers(rows[0][2]) == bits
    for message in (m.Ping(1), m.Pong(1, 2, 3)):
        wire = encode(message, board=DRIVE, seq=0x55, session=0x66)
        sent = m.from_plc(message.ID)
        assert wire[1:5] == bytes([m.MAJOR << 5 | sent << 4 | DRIVE, message.ID, 0x55, 0x66])
    first, last_to_plc, first_to_host, last = numbers(rows[1][2])
    assert [m.from_plc(code) for code in (first, last_to_plc)] == [False, False]
    assert [m.from_plc(code) for code in (first_to_host, last)] == [True, True]
    assert numbers(rows[2][2]) == [1, 256]
    assert numbers(rows[3][2]) == [1, 255, 0]


def test_the_rules_of_the_decoder_are_those_described():
    rows = table("1.5 Decoder", "rule", "the segment is dropped if", "counter")
    assert [int(number) for number, *_ in rows] == list(range(1, 10))
    assert [counter for *_, counter in rows] == [
        "none", "length", "cobs", "length", "crc", "version", "unknown", "session", "length",
    ]  # fmt: skip
    largest, smallest = 4 + m.MAX_PAYLOAD + 4, 4 + 4
    found = [numbers(text) for _, text, _ in rows]
    assert found == [[], [largest + 1, 0x00], [], [smallest], [], [m.MAJOR], [], [], [2]]


# ---- limits, constants, times ----


def test_limits_are_those_of_both_codes(macros):
    rows = {row[0]: row[1:] for row in table("5.5 Limits", "limit", "value", "on the wire")}
    expected = {
        "steering motor, either side": (limits.MAX_STEERING_ANGLE, "MAX_ANGLE", 1),
        "rate of the steering motor": (limits.MAX_STEERING_RATE, "MAX_RATE", 1),
        "speed": (limits.MAX_SPEED, "MAX_SPEED", 1),
        "acceleration and deceleration": (limits.MAX_ACCELERATION, "MAX_ACCELERATION", 1),
        "torque of the motor": (limits.MAX_TORQUE, "MAX_TORQUE", 10),
        "its braking torque": (limits.MAX_REGENERATIVE_TORQUE, "MAX_REGENERATIVE_TORQUE", 10),
        "its power": (limits.MAX_POWER, "MAX_POWER", 1000),
        "brake": (100.0, "MAX_BRAKE", 1),
    }
    assert {name: (number(v), int(wire)) for name, (v, wire) in rows.items()} == {
        name: (value, macros[macro] / counts) for name, (value, macro, counts) in expected.items()
    }


OWN = table("5.5 Limits", "field of SETUP", "on the wire", "the board's own")


def test_every_field_of_setup_has_its_range_and_the_board_s_own_value(make_bench):
    described = [row[0] for row in OWN]
    assert sorted(described) == sorted({name for kind in SETUP.values() for name in m.layout(kind)})
    for board in (STEER, DRIVE):
        bench = make_bench(board)
        bench.tick()
        bench.hello()
        bench.tick()
        (answer,) = bench.send(m.LimitsRequest())
        own = {name: int(value) for name, _, value in OWN if name in m.layout(SETUP[board])}
        shared = {"supply_low": 0, "supply_high": 0}
        assert {name: getattr(answer, name) for name in own} == own | shared


def beyond(name, text):
    """Values just within and just beyond what the table says of a field."""
    found = [int(x) for x in re.findall(r"\d+", text.partition(",")[0])]
    if text.startswith("at most"):
        return [found[0]], [found[0] + 1]
    return ([found[0], found[1]], [found[0] - 1, found[1] + 1]) if found[1:] else ([], [])


@pytest.mark.parametrize(
    "row", [row for row in OWN if re.search(r"\d{2}", row[1])], ids=lambda r: r[0]
)
def test_the_range_of_a_field_of_setup_is_the_one_described(row, make_bench):
    name, text, _ = row
    board = STEER if name in m.layout(m.SteerSetup) else DRIVE
    within, outside = beyond(name, text)
    for value in outside + within:
        bench = make_bench(board)
        bench.tick()
        bench.hello()
        # what must not be less than the field
        more = {"mass_low": {"mass_high": 60_000}, "mass_high": {"mass_low": 10}}.get(name, {})
        result = bench.set_up(**more | {name: value})
        assert result is (Result.OK if value in within else Result.OUT_OF_RANGE), value


def test_constants_of_the_boards_are_those_of_both_codes(macros):
    rows = {row[0]: number(row[1]) for row in table("5.9 Boards", "constant", "value")}
    lines = {row[0]: row[1] for row in table("5.9 Boards", "constant", "value")}
    bands = {"hall lines, low": boards.LINE_LOW, "hall lines, high": boards.LINE_HIGH}
    for name, (low, high) in bands.items():
        assert lines[name] == f"{low} to {high} V"
        del rows[name]
    counts = [round(volts / 5 * 1023) for band in bands.values() for volts in band]
    names = ("LINE_LOW_MIN", "LINE_LOW_MAX", "LINE_HIGH_MIN", "LINE_HIGH_MAX")
    assert [macros[name] for name in names] == counts
    assert rows == {
        "potentiometer, centre": boards.ADC_CENTRE,
        "potentiometer, scale": boards.ADC_SCALE,
        "hall pulse": boards.HALL_PULSE,
        "tyre radius": boards.TYRE_RADIUS,
        "servo, centre": boards.SERVO_CENTRE,
        "servo, span": boards.SERVO_SPAN,
        "full PWM": limits.MAX_TORQUE,
        "drive supply": boards.DRIVE_SUPPLY,
        "steer supply": boards.STEER_SUPPLY,
    }
    meanings = {row[0]: row[2] for row in table("5.9 Boards", "constant", "value", "meaning")}
    assert f"{limits.STEERING_END_STOP} rad" in meanings["servo, span"]
    assert rows["potentiometer, centre"] == macros["ADC_CENTRE"]
    assert rows["potentiometer, scale"] == macros["ADC_SCALE"]
    assert round(rows["hall pulse"] * 1e6) == macros["HALL_PULSE"]
    assert round(rows["tyre radius"] * 1e4) == macros["TYRE_RADIUS"]
    assert rows["servo, centre"] == macros["SERVO_CENTRE"]
    assert rows["servo, span"] == macros["SERVO_SPAN"]
    assert rows["full PWM"] * 1e3 == macros["MAX_TORQUE"]


def test_thresholds_of_faults_are_those_of_both_codes(macros):
    when = {row[1]: row[2] for row in table("5.7 Faults", "bit", "fault")}
    found = {
        name: [float(x) for x in re.findall(r"\d+(?:\.\d+)?", text)] for name, text in when.items()
    }
    assert found["CMD_TIMEOUT"] == [limits.WATCHDOG * 1e3]
    assert found["TRACKING"] == [boards.TRACKING_ERROR, boards.TRACKING_TIME]
    assert found["SENSOR"] == [boards.ADC_LOW, boards.ADC_HIGH]
    assert found["OVERSPEED"] == [boards.OVERSPEED_MARGIN, boards.RUNAWAY_MARGIN, 5.6]
    assert found["HALL_LINE"] == [5.8, boards.LINE_TICKS]
    assert found["STOP_TIMEOUT"] == [boards.STOPPING_TIME]
    (at_rest,) = re.findall(r"\*At rest\* is a measured speed below ([\d.]+) m/s", DOCUMENT)
    assert float(at_rest) == boards.AT_REST
    names = ("WATCHDOG_MS", "TRACKING_ERROR", "TRACKING_MS", "ADC_LOW", "ADC_HIGH",
             "STOPPING_MS", "OVERSPEED_MARGIN", "RUNAWAY_MARGIN", "LINE_TICKS",
             "AT_REST")  # fmt: skip
    in_c = (200, 1500, 1000, 5, 1018, 8000, 480, 220, 3, 20)
    assert [macros[name] for name in names] == list(in_c)


def told(heading, pattern):
    """Numbers in the text of a section."""
    (found,) = re.findall(pattern, " ".join(section(heading).split()))
    return [float(x) for x in ([found] if isinstance(found, str) else found)]


def test_numbers_in_the_text_are_those_of_the_code(macros):
    assert told("1.2 Frame", r"are at most (\d+) bytes of the line") == [limits.ANSWER_BUDGET]
    assert macros["ANSWER_BUDGET"] == limits.ANSWER_BUDGET
    assert told("5.4 Arming", r"the measured one is ([\d.]+) m/s or more") == [limits.ARMING_SPEED]
    assert macros["ARMING_SPEED"] == limits.ARMING_SPEED * 1e3
    stopping = r"differ by more than ([\d.]+) m/s the brake grows by (\d+) % of full"
    expected = [boards.STOPPING_EXCESS, boards.STOPPING_BRAKE_RATE * 100]
    assert told("5.6 Set-points", stopping) == expected
    assert told("5.6 Set-points", r"deceleration in force, and with ([\d.]+) m/s² at least") == [
        boards.STOPPING_DECELERATION
    ]
    assert told("5.6 Set-points", r"commanded deceleration and with ([\d.]+) m/s² at least") == [
        boards.STOPPING_DECELERATION
    ]
    assert macros["STOPPING_DECELERATION"] == boards.STOPPING_DECELERATION * 1e3
    assert told("5.6 Set-points", r"After (\d+) s the PLC gives up") == [boards.STOPPING_TIME]
    assert told("5.6 Set-points", r"- (\d+) s have passed since it left") == [boards.HOLDING_TIME]
    assert told("5.5 Limits", r"end stop of its mechanics at ([\d.]+) rad") == [
        limits.STEERING_END_STOP
    ]
    ceiling = (
        r"max\(([\d.]+) m/s, speed - lagging\).*? 10 ms / ([\d.]+) s .*?"
        r" more than ([\d.]+) m/s above the ceiling"
    )
    assert told("5.6 Set-points", ceiling) == [
        boards.OVERSHOOT,
        boards.OVERSHOOT_TIME,
        boards.RUNAWAY_MARGIN,
    ]
    assert macros["OVERSHOOT"] == boards.OVERSHOOT * 1e3
    assert macros["OVERSHOOT_TICKS"] == boards.OVERSHOOT_TIME * 1e2
    wheel = "5.8 Does the wheel"
    bands = r"low is ([\d.]+) to ([\d.]+) V, high ([\d.]+) to ([\d.]+) V"
    assert told(wheel, bands) == [*boards.LINE_LOW, *boards.LINE_HIGH]
    assert told(wheel, r"outside of its bands in (\d+) ticks") == [boards.LINE_TICKS]
    assert told(wheel, r"a lag of ([\d.]+) s") == [boards.TORQUE_LAG]
    assert told(wheel, r"within ±([\d.]+) m/s²") == [boards.RESISTANCE]
    assert told(wheel, r"by ([\d.]+) pulses") == [boards.PULSE_MARGIN]
    assert told(wheel, r"more than ([\d.]+) m/s against the gear") == [boards.AGAINST_GEAR]
    silent = r"no pulse for ([\d.]+) s and the set-point is ([\d.]+) m/s or more"
    assert told(wheel, silent) == [boards.NO_PULSE_TIME, boards.NO_PULSE_SPEED]


def milliseconds(text):
    value, unit = re.fullmatch(r"([\d.× ]+) (ms|s)", text).groups()
    factors = [float(factor) for factor in value.split("×")]
    product = factors[0] * (factors[1] if len(factors) > 1 else 1.0)
    return round(product * (1e3 if unit == "s" else 1.0), 6)


def test_times_of_a_plc_are_those_of_both_codes(macros):
    rows = {r[0]: milliseconds(r[1]) for r in table("9 Times", "time of a PLC", "value")}
    assert rows == {
        "tick, state frame": TICK * 1e3,
        "watchdog: no accepted command": limits.WATCHDOG * 1e3,
        "stale echo": round(limits.STALE_TICKS * limits.ECHO_TICK * 1e3, 6),
        "steer PLC holds its angle after ARMED": boards.HOLDING_TIME * 1e3,
        "TRACKING": boards.TRACKING_TIME * 1e3,
        "STOP_TIMEOUT": boards.STOPPING_TIME * 1e3,
        "PULSES: no pulse": boards.NO_PULSE_TIME * 1e3,
        "brake after a push without a pulse": boards.RESTING_TIME * 1e3,
        "HALL_LINE": boards.LINE_TICKS * TICK * 1e3,
        "hardware watchdog": boards.HARDWARE_WATCHDOG * 1e3,
    }
    in_seconds = ("PULSES: no pulse", "brake after a push without a pulse")
    names = ("WATCHDOG_MS", "HOLDING_MS", "TRACKING_MS", "STOPPING_MS", "HARDWARE_WATCHDOG_MS")
    assert [macros["TICK_US"] / 1e3, *(macros[name] for name in names)] == [
        rows[name] for name in rows if name not in ("stale echo", *in_seconds, "HALL_LINE")
    ]
    (units,) = re.findall(r"& 0xFFFF ≤ (\d+)", section("4 Freshness"))
    assert int(units) == limits.STALE_TICKS == macros["STALE_TICKS"]


def test_times_of_the_host_are_those_of_the_code():
    rows = {r[0]: milliseconds(r[1]) for r in table("9 Times", "time of the host", "value")}
    assert rows == {
        "HELLO": handshake.HELLO_PERIOD * 1e3,
        "no answer to HELLO is reported": handshake.HELLO_PATIENCE * 1e3,
        "refused port is tried again": link.REFUSED_PAUSE * 1e3,
        "PING, until 16 are answered": link.FIRST_PING_PERIOD * 1e3,
        "PING after that": link.PING_PERIOD * 1e3,
        "STATS_REQ, and LIMITS_REQ until it is answered": link.STATS_PERIOD * 1e3,
        "LIMITS_REQ and STATS_REQ apart": link.REQUEST_GAP * 1e3,
        "CTRL, SETUP are repeated": operations.RESEND_PERIOD * 1e3,
        "SETUP without an answer is tried again": link.SETUP_PAUSE * 1e3,
        "telemetry degraded": link.DEGRADED_AGE * 1e3,
        "telemetry lost": link.LOST_AGE * 1e3,
        "reboot: clocks disagree": link.REBOOT_DISAGREEMENT * 1e3,
        "own input too old": command_stream.INPUT_AGE * 1e3,
        "arming given up": arming.ARMING_PATIENCE * 1e3,
    }


def test_the_line_load_is_that_of_the_messages():
    wire = {row[1]: int(row[4]) + 10 for row in MESSAGE_ROWS}
    for stream, size, load in table("9 Times", "stream", "bytes per frame", "load"):
        name, rate = re.fullmatch(r"(\w+), (\d+) Hz", stream).groups()
        assert int(size) == wire[name]
        assert number(load) == pytest.approx(100 * int(rate) * wire[name] / 11520, abs=0.051)
    assert m.BAUD / 10 == 11520


# ---- test vectors ----


CODES = {"u8": "B", "i16": "h", "u16": "H", "i32": "i", "u32": "I"}


@pytest.mark.parametrize("row", table("8 Test vectors", "frame", "message"), ids=lambda r: r[0][:8])
def test_a_vector_is_what_the_document_says_and_the_codec_makes_and_reads(row):
    wire, name, board, seq, session, values = row
    board, seq, session = m.Board(int(board)), int(seq), int(session, 0)
    (described,) = [
        r for r in MESSAGE_ROWS if r[1] == name and r[3] in (board.name.lower(), "both")
    ]
    code, cls = int(described[0], 16), CLASSES[described[5]]
    fields = [int(value, 0) for value in values.split(", ")] if values else []
    fields += [0] * (len(FIELDS.get(described[5], [])) - len(fields))
    # by sections 1 and 2, with other people's CRC and COBS
    types = "".join(CODES[kind] for _, kind in FIELDS.get(described[5], []))
    head = bytes([m.MAJOR << 5 | (described[2] == "PLC") << 4 | board, code, seq, session])
    raw = head + struct.pack("<" + types, *fields)
    raw += zlib.crc32(raw).to_bytes(4, "little")
    assert (cobs.encode(raw) + b"\0").hex() == wire
    message = cls(*fields)
    assert encode(message, board=board, seq=seq, session=session).hex() == wire
    decoder = FrameDecoder(STEER if board is m.Board.ANY else board, host=m.from_plc(code))
    decoder.session = session
    decoded = [(f.message, f.seq, f.session) for f in decoder.feed(bytes.fromhex(wire))]
    assert decoded == ([(message, seq, session)] if session else [])


def test_the_checksum_is_the_one_described():
    (value,) = re.findall(r"`123456789` is (0x\w+)", section("1.3 Checksum"))
    assert zlib.crc32(b"123456789") == int(value, 16)


# ---- the state machine, row by row ----


def to_safe(bench):
    """Nothing to do: a bench begins in SAFE."""


def to_armed(bench):
    bench.armed().drive(20, 0.2)


def to_stopping(bench):
    bench.armed().drive(40, 0.3)
    bench.drive(1, 0.3, flags=0)


def to_estop(bench):
    bench.control(Op.ESTOP)


def to_fault(bench):
    bench.armed().command()
    bench.tick(**({"adc": 0} if bench.board is STEER else {"speed": 6.0}))
    bench.tick(**({"adc": None} if bench.board is STEER else {"speed": 0.0}))


ENTER = {
    "SAFE": to_safe,
    "ARMED": to_armed,
    "STOPPING": to_stopping,
    "ESTOP": to_estop,
    "FAULT": to_fault,
}


def arm(bench):
    bench.drive(5)
    bench.control(Op.ARM)


def blocked(bench, seconds):
    """Commands go on, the measurement does not move."""
    before = bench.plc.state
    for _ in range(round(100 * seconds)):
        if bench.plc.state is before:
            bench.command(0.5)
            bench.tick(**({"angle": 0.0} if bench.board is STEER else {"speed": 0.0}))


def come_to_rest(bench):
    for _ in range(200):
        if bench.plc.state is State.STOPPING:
            bench.drive(1, flags=0)


def turn_the_wrong_way(bench):
    """The wheel, after a moment in which it turned as it should."""
    flags = ENABLE if bench.plc.state is State.ARMED else 0
    bench.command(0.5, flags=flags)
    bench.roll(1, bench.output.setpoint)
    while bench.plc.state in (State.ARMED, State.STOPPING):
        bench.command(0.5, flags=flags)
        bench.tick(speed=-0.45)


def never_come_to_rest(bench):
    while bench.plc.state is State.STOPPING:
        bench.roll(1, 0.3)


def say_standstill(bench):
    bench.command(flags=ENABLE | STANDSTILL)
    bench.tick()


def reset(bench):
    bench.plc.reset()


EVENTS = {
    "ARM accepted": arm,
    "DISARM": lambda bench: bench.control(Op.DISARM),
    "HELLO to this board": lambda bench: bench.send(m.Hello(0, bench.board, 5)),
    "tick: no command accepted for 200 ms": lambda bench: bench.tick(21),
    "accepted command without ENABLE": lambda bench: bench.command(flags=0),
    "tick: 10 s after it left ARMED": lambda bench: bench.tick(1001),
    "tick: a command said STANDSTILL": say_standstill,
    "tick: at rest, set-point 0": come_to_rest,
    "ESTOP": lambda bench: bench.control(Op.ESTOP),
    "accepted command with the ESTOP flag": lambda bench: bench.command(flags=ENABLE | ESTOP),
    "tick: hardware e-stop pressed": lambda bench: bench.tick(estop_pressed=True),
    "tick: potentiometer out of range": lambda bench: bench.tick(adc=1019),
    "tick: angle off its set-point for 1 s": lambda bench: blocked(bench, 1.2),
    "tick: the wheel does not turn as it should": turn_the_wrong_way,
    "tick: 8 s in this state": never_come_to_rest,
    "tick: wheel too fast": lambda bench: bench.tick(speed=-5.29),
    "tick: wheel gains speed against the motor": lambda bench: bench.tick(speed=0.7),
    "tick: a line of the hall sensor is broken": lambda bench: bench.tick(3, hall_line=5.0),
    "CLEAR accepted": lambda bench: bench.control(Op.CLEAR),
    "reset": reset,
}
TRANSITIONS = [
    (board, state, event, to, faults)
    for whose, states, event, to, faults in table("5.2 Transitions", "board", "from", "event", "to")
    for board in BOARDS[whose]
    for state in states.split(", ")
]


def names(values):
    return " ".join(getattr(value, "name", value) for value in values)


@pytest.mark.parametrize("row", TRANSITIONS, ids=names)
def test_a_row_of_the_transition_table_happens(row, make_bench):
    board, before, event, to, faults = row
    bench = make_bench(board)
    if before == "BOOT":
        assert bench.plc.state is State.BOOT
        bench.tick()
    else:
        ENTER[before](bench.booted())
        assert bench.plc.state is State[before]
        had = bench.plc.faults & ~Fault.LIMIT
        bench.received.clear()
        EVENTS[event](bench)
        added = Fault(0) if faults in ("", "none") else Fault[faults]
        if event != "reset":
            expected = Fault(0) if faults == "none" else had | added
            assert bench.plc.faults & ~Fault.LIMIT == expected
    assert bench.plc.state is State[to]
    told = [e.states for e in bench.received if isinstance(e, m.Event)]
    # a reset is told by the first tick after it
    assert told == ([] if to == "BOOT" or before == to else [State[before] << 4 | State[to]])


# those that take no time, in which STOPPING might end by itself
BRIEF = [event for event in EVENTS if not re.search(r" for |\d s|at rest", event)]
OF_OTHER_BOARD = {
    DRIVE: {"tick: potentiometer out of range", "tick: a command said STANDSTILL"},
    STEER: {
        "tick: wheel too fast",
        "tick: wheel gains speed against the motor",
        "tick: a line of the hall sensor is broken",
        "tick: the wheel does not turn as it should",
    },
}


@pytest.mark.parametrize("before", ENTER)
@pytest.mark.parametrize("board", [STEER, DRIVE], ids=lambda board: board.name)
def test_no_other_event_changes_the_state(board, before, make_bench):
    listed = {event for of, state, event, *_ in TRANSITIONS if (of, state) == (board, before)}
    for event in set(BRIEF) - listed - OF_OTHER_BOARD[board]:
        bench = make_bench(board).booted()
        ENTER[before](bench)
        EVENTS[event](bench)
        assert bench.plc.state is State[before], event


def test_every_event_of_the_table_is_tried():
    described = {event for *_, event, _, _ in TRANSITIONS} - {"first tick"}
    assert described == set(EVENTS)


OPERATIONS = table("5.3 Operations", "op", "SAFE", "ARMED", "STOPPING", "ESTOP", "FAULT")


@pytest.mark.parametrize(
    ("op", "state", "result"),
    [
        (op, state, result)
        for op, *results in OPERATIONS
        for state, result in zip(ENTER, results, strict=True)
        if result in Result.__members__
    ],
)
@pytest.mark.parametrize("board", [STEER, DRIVE], ids=lambda board: board.name)
def test_an_operation_has_the_result_of_the_table(board, op, state, result, make_bench):
    bench = make_bench(board).booted()
    ENTER[state](bench)
    assert bench.control(Op[op]).name == result
    if op == "CLEAR" and result == "OK":
        bench.tick(estop_pressed=True)
        assert bench.control(Op.CLEAR) is Result.PRECONDITIONS
    assert [row[0] for row in OPERATIONS] == [op.name for op in Op if op is not Op.SETUP]


@pytest.mark.parametrize("board", [STEER, DRIVE], ids=lambda board: board.name)
@pytest.mark.parametrize("state", ENTER)
def test_outputs_are_those_of_the_state(board, state, make_bench):
    (row,) = [row for row in table("5.1 States", "value", "state") if row[1] == state]
    bench = make_bench(board).booted()
    ENTER[state](bench)
    if state == "ARMED":
        bench.drive(2, 0.3)
    if state != "STOPPING":
        bench.tick()
    _, _, servo, motor, brake, _ = row
    output = bench.output
    if board is STEER:
        holds = servo == "off unless it holds" and state == "FAULT"  # the others were not armed
        assert output.servo_on is (servo == "on" or holds)
    else:
        assert output.motor_on is motor.startswith("on")
        kind = re.split("[,;]", brake)[0]
        assert output.brake == {"full": 1.0, "off": 0.0, "as it was": 0.0}[kind]


def test_arming_needs_as_many_commands_as_the_document_says(make_bench):
    (needed,) = re.findall(r"Fewer than (\d+) accepted commands", section("5.4 Arming"))
    for board, fewer in itertools.product((STEER, DRIVE), (0, 1)):
        bench = make_bench(board).booted()
        bench.drive(int(needed) - fewer)
        assert bench.control(Op.ARM) is (Result.PRECONDITIONS if fewer else Result.OK)
    assert int(needed) == limits.ARMING_COMMANDS
