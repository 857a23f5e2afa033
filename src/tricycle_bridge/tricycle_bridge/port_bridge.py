"""A bridge and its two serial ports: what came in to the bridge, what it sends to the ports."""

from __future__ import annotations

from tricycle_bridge.bridge import Bridge
from tricycle_bridge.serial_port import Closed, Opened, Received, SerialPorts


def receive_all(bridge: Bridge, ports: SerialPorts, now: float) -> None:
    """Give the bridge the events of the ports, and let it act.

    Parameters
    ----------
    bridge : Bridge
        Bridge with both links.
    ports : SerialPorts
        Serial ports of the boards.
    now : float
        Present time on the bridge's clock [s].
    """
    events = ports.take_events()
    for event in events:
        match event:
            case Received():
                bridge.receive(event.board, event.data, now)
            case Opened():
                bridge.opened(event.board, now)
            case Closed():
                bridge.closed(event.board, event.reason)
    if events or bridge.poll_is_due(now):
        bridge.poll(now)


def send_all(bridge: Bridge, ports: SerialPorts) -> None:
    """Write the bridge's frames; open a port again where the link asks for it.

    Parameters
    ----------
    bridge : Bridge
        Bridge with both links.
    ports : SerialPorts
        Serial ports of the boards.
    """
    for board, link in bridge.links.items():
        if frames := link.take_frames():
            link.counters.write_drops += ports.write(board, frames)
        if link.wants_reopen:
            ports.reopen(board, link.down_reason)
