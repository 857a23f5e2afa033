"""The firmware's header against the message table it is generated from."""

from pathlib import Path

from tricycle_bridge.protocol.firmware_header import firmware_header

HEADER = Path(__file__).parents[3] / "firmware" / "messages.h"


def test_the_header_in_the_repository_is_not_stale():
    assert HEADER.read_text() == firmware_header(), (
        "run `python -m tricycle_bridge.protocol.firmware_header > firmware/messages.h`"
    )
