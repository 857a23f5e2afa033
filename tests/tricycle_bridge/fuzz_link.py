"""Coverage-guided fuzzing of decoder, link, bridge and emulated PLC (needs atheris).

    python tests/tricycle_bridge/fuzz_link.py -runs=50000 -seed=1

The input is a script: each step is an opcode that feeds raw bytes, a well-formed frame with fuzzed
content, or time, to a host link or a PLC. What must hold: nothing raises, buffers stay bounded, no
set-point leaves the limits, and a PLC is armed only by an ARM of its own session.
"""

import random
import sys

import atheris

import tricycle_sim.setpoints  # noqa: F401 - compiled by numba, which instrumented code is not

with atheris.instrument_imports(include=["tricycle_bridge", "tricycle_sim.plc"]):
    from tricycle_bridge.commands.board_commands import board_setup
    from tricycle_bridge.plc_link.link import PlcLink
    from tricycle_bridge.protocol.framing import encode
    from tricycle_bridge.protocol.messages import (
        MAJOR,
        MESSAGES,
        Board,
        Control,
        Op,
        PlcState,
        layout,
    )
    from tricycle_bridge.settings import BridgeSettings
    from tricycle_sim.plc import DriveMeasurement, DrivePlc, SteerMeasurement, SteerPlc


def _frame(data: atheris.FuzzedDataProvider, session: int):
    cls = MESSAGES[data.ConsumeIntInRange(0, len(MESSAGES) - 1)]
    values = [data.ConsumeIntInRange(w.low, w.high) for w in layout(cls).values()]
    message = cls(*values)
    board = (Board.STEER, Board.DRIVE, Board.ANY)[data.ConsumeIntInRange(0, 2)]
    session = session if data.ConsumeBool() else data.ConsumeIntInRange(0, 255)
    seq = data.ConsumeIntInRange(0, 255)
    major = data.ConsumeIntInRange(0, 7) if data.ConsumeBool() else MAJOR
    return message, encode(message, board=board, seq=seq, session=session, major=major)


def test_one_input(raw: bytes) -> None:
    data = atheris.FuzzedDataProvider(raw)
    steer = data.ConsumeBool()
    plc = SteerPlc() if steer else DrivePlc()
    link = PlcLink(plc.board, rng=random.Random(0), setup=board_setup(plc.board, BridgeSettings()))
    measured = SteerMeasurement() if steer else DriveMeasurement()
    now, now_us = 0.0, 0
    link.opened(now)
    arm_sent = False
    while data.remaining_bytes():
        match data.ConsumeIntInRange(0, 5):
            case 0:
                noise = data.ConsumeBytes(data.ConsumeIntInRange(0, 80))
                link.receive(noise, now)
                plc.receive(noise, now_us)
            case 1:
                message, wire = _frame(data, plc.session)
                arm_sent |= isinstance(message, Control) and message.op == Op.ARM
                plc.receive(wire, now_us)
            case 2:
                _, wire = _frame(data, link.decoder.session)
                link.receive(wire, now)
            case 3:
                step = data.ConsumeIntInRange(0, 400_000)
                now, now_us = now + step * 1e-6, now_us + step
            case 4:
                link.operate(Op(data.ConsumeIntInRange(0, 3)), now)
                arm_sent = True
            case _:
                link.poll(now)
                answer = plc.receive(b"".join(link.take_frames()), now_us)
                telemetry, output = plc.tick(now_us, measured)
                link.receive(answer + telemetry, now)
                assert abs(output.setpoint) <= (0.7855 if steer else 4.801)
                now, now_us = now + 0.01, now_us + 10_000
        assert link.decoder.pending <= 50
        assert arm_sent or plc.state is not PlcState.ARMED
        if link.wants_reopen:
            link.closed("reopened")
            link.opened(now)


if __name__ == "__main__":
    atheris.Setup(sys.argv, test_one_input)
    atheris.Fuzz()
