"""A pty as a serial device: publishing, full lines, unplugging."""

import os
import subprocess
import sys

import pytest
import serial

from tricycle_core.errors import LinkError
from tricycle_sim.plc.pty_port import PtyPort

pytestmark = pytest.mark.real_time


def test_bytes_pass_unchanged_both_ways(tmp_path):
    every_byte = bytes(range(256))
    with PtyPort(tmp_path / "plc") as port, serial.Serial(str(port.path), timeout=1) as host:
        host.write(every_byte)
        received = b""
        while len(received) < 256:
            received += port.read()
        assert received == every_byte
        assert port.write(every_byte)
        assert host.read(256) == every_byte


def test_the_link_is_replaced_atomically_and_removed_at_the_end(tmp_path):
    link = tmp_path / "deeper" / "plc"
    with PtyPort(link) as first:
        with PtyPort(link) as second:
            device = os.path.realpath(link)
            first.unplug()
            assert os.path.realpath(link) == device  # it is the second one's now
            with serial.Serial(str(link), timeout=1) as host:
                assert second.write(b"x")
                assert host.read(1) == b"x"
        assert not link.is_symlink()
    assert list(link.parent.iterdir()) == []


def test_a_file_in_the_place_of_the_link_is_kept(tmp_path):
    (tmp_path / "plc").write_text("precious")
    with pytest.raises(LinkError, match="plc is not a link to a serial device: it is not replaced"):
        PtyPort(tmp_path / "plc")
    assert (tmp_path / "plc").read_text() == "precious"


def test_the_device_of_another_simulation_is_kept_until_that_is_gone(tmp_path):
    code = (
        "import sys; from tricycle_sim.plc.pty_port import PtyPort\n"
        "port = PtyPort(sys.argv[1]); print(port.path, flush=True); sys.stdin.read()"
    )
    link = tmp_path / "steer"
    with subprocess.Popen(
        [sys.executable, "-c", code, link], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as other:
        assert other.stdout.readline().strip() == str(link)
        device = link.readlink()
        with pytest.raises(LinkError, match="steer is the serial device of another simulation"):
            PtyPort(link)
        assert link.readlink() == device
        other.kill()
    assert link.is_symlink()  # as a kill leaves it
    with PtyPort(link) as port:
        assert port.path.exists()


def test_a_port_survives_that_no_host_is_there(tmp_path):
    with PtyPort(tmp_path / "plc") as port:
        assert port.read() == b""
        serial.Serial(str(port.path)).close()
        assert port.read() == b""
        assert port.write(b"x")


def test_a_full_line_drops_and_counts_without_blocking(tmp_path):
    with PtyPort(tmp_path / "plc") as port:
        written = 0
        while port.write(bytes(100)):
            written += 100
            assert written < 1_000_000
        assert port.dropped == 1
        assert not port.write(bytes(100))
        assert port.dropped == 2


def test_unplugging_is_an_error_for_the_host_and_plugging_makes_a_new_device(tmp_path):
    with PtyPort(tmp_path / "plc") as port:
        host = serial.Serial(str(port.path), timeout=1)
        port.unplug()
        assert not port.path.exists()
        with pytest.raises(serial.SerialException):
            host.read(1)
        assert (port.read(), port.write(b"x")) == (b"", False)
        host.close()
        port.plug()
        with serial.Serial(str(port.path), timeout=1) as again:
            again.write(b"hello")
            received = b""
            while len(received) < 5:
                received += port.read()
        assert received == b"hello"
