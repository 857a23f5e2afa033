"""Probing a port, whichever board is behind it."""

import pytest

from tricycle_bridge.commissioning.probe import PortProbe
from tricycle_bridge.protocol.messages import Board, DriveLimits
from tricycle_core.errors import LinkError
from tricycle_sim.plc.pty_port import PtyPort

pytestmark = pytest.mark.real_time


@pytest.mark.slow
@pytest.mark.parametrize("board", [Board.STEER, Board.DRIVE])
def test_it_finds_out_which_board_answers(plc_pair, board):
    path = plc_pair.steer_path if board is Board.STEER else plc_pair.drive_path
    with PortProbe(path, boot_wait=0.0) as probe:
        link = probe.handshake()
        assert (link.board, link.identity.board) == (board, board)
        for _ in probe.events(0.5):
            pass
        assert link.stats is not None
        if board is Board.DRIVE:
            assert isinstance(link.limits, DriveLimits)


def test_a_missing_port_and_a_silent_one_are_one_clear_line(tmp_path):
    with (
        PortProbe(str(tmp_path / "none"), boot_wait=0.0) as probe,
        pytest.raises(LinkError, match="none does not exist"),
    ):
        probe.handshake()
    with (
        PtyPort(tmp_path / "silent") as port,
        PortProbe(str(port.path), boot_wait=0.0) as probe,
        pytest.raises(LinkError, match=r"silent: no PLC answers within 0\.3 s \(0 good frames"),
    ):
        probe.handshake(timeout=0.3)


def test_a_plc_that_falls_silent_for_good_ends_it(plc_pair, monkeypatch):
    with PortProbe(plc_pair.drive_path, boot_wait=0.0) as probe:
        probe.handshake()
        monkeypatch.setattr("tricycle_bridge.plc_link.handshake.HELLO_PATIENCE", 0.2)
        plc_pair.stall(Board.DRIVE)
        with pytest.raises(LinkError, match="no drive PLC answers"):
            list(probe.events(20.0))
