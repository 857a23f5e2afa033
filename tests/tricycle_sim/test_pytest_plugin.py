"""The fixture that others use, as others use it."""

import time

import serial

from tricycle_bridge.protocol.framing import FrameDecoder, encode
from tricycle_bridge.protocol.messages import Board, Hello, HelloAck


def test_plc_pair_answers_on_two_serial_devices(plc_pair):
    for board, path in ((Board.STEER, plc_pair.steer_path), (Board.DRIVE, plc_pair.drive_path)):
        decoder = FrameDecoder(board, host=True)
        decoder.session = 5
        with serial.Serial(path, 115200, timeout=0.05) as port:
            port.write(b"\0" + encode(Hello(0, board, 77), board=board, seq=0, session=5))
            acks = []
            deadline = time.monotonic() + 5.0
            while not acks and time.monotonic() < deadline:
                frames = decoder.feed(port.read(64))
                acks = [f.message for f in frames if isinstance(f.message, HelloAck)]
        assert [(ack.board, ack.nonce) for ack in acks] == [(board, 77)]
        assert plc_pair.plc(board).session == 5
