"""Bags on a computer that is reached by SSH: a real server, its key, few bytes, cut connections."""

import pickle
import threading
import time

import numpy as np
import paramiko
import pytest
from camera_bag import WANTED, write_camera_bag
from driven_bags import VEHICLE, SimulatedBag
from fsspec.config import conf
from fsspec.implementations.sftp import SFTPFileSystem
from sftp_server import SftpServer

from parameter_identification.drives.kept import content_key
from parameter_identification.drives.measured_from_bag import read_measured_drive
from trajectory_recorder.bag import location, remote
from trajectory_recorder.bag.location import bag_path
from trajectory_recorder.bag.reader import BagReader
from tricycle_cli.main import main
from tricycle_core.errors import BagError

pytestmark = pytest.mark.slow

USER = paramiko.ECDSAKey.generate()


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with a bag of a camera, and of a small topic that is wanted."""
    folder = tmp_path_factory.mktemp("store")
    write_camera_bag(folder / "bag", 20)
    return folder


@pytest.fixture(autouse=True)
def home(tmp_path, monkeypatch):
    """The home folder of a user with a key, who knows no host yet."""
    monkeypatch.setattr(remote, "PAUSE", 0.001)
    monkeypatch.setattr(location, "TIMEOUT", 2.0)
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.delenv("SSH_AUTH_SOCK", raising=False)
    (tmp_path / ".ssh").mkdir()
    USER.write_private_key_file(str(tmp_path / ".ssh" / "id_ecdsa"))
    yield tmp_path
    SFTPFileSystem.clear_instance_cache()


def known(server, home):
    (home / ".ssh" / "known_hosts").write_text(server.known_host)
    return server.url


def messages(path):
    with BagReader(path) as bag:
        return list(bag.messages())


def test_only_the_chunks_of_wanted_topics_are_fetched(folder, home):
    with SftpServer(folder, USER) as server:
        path = bag_path(f"{known(server, home)}/bag")
        assert messages(path) == messages(folder / "bag")
        assert server.connections == 1
        before = server.sent
        with BagReader(path) as bag:
            assert len(list(bag.messages([WANTED]))) == 200
            assert bag.size > 4e6
            assert bag.fetched < 0.06 * bag.size
            assert server.sent - before < bag.fetched + 10_000  # metadata.yaml


def test_a_bag_is_identified_from(tmp_path, home, capsys):
    bag = SimulatedBag().write(tmp_path / "drive")
    with SftpServer(tmp_path, USER) as server:
        path = bag_path(f"{known(server, home)}/drive")
        found, local = read_measured_drive(path, VEHICLE), read_measured_drive(bag, VEHICLE)
        assert str(path) == str(pickle.loads(pickle.dumps(path))) == f"{server.url}/drive"
        assert found.name == "drive"
        for sensor, signal in local.signals.items():
            np.testing.assert_array_equal(found.signals[sensor].values, signal.values)
        assert content_key(path, VEHICLE) == content_key(path, VEHICLE)
        assert main(["bag", "info", f"{server.url}/drive"]) == 0
        assert "MB fetched)" in capsys.readouterr().out
        (bag / "metadata.yaml").unlink()  # as a killed recorder leaves it: listed then
        assert len(read_measured_drive(path, VEHICLE).signals) == len(local.signals)


def refused(capsys, url):
    """The line that says why a bag is not read."""
    assert main(["bag", "info", url]) == 2
    told = capsys.readouterr().err
    assert told.count("\n") == 1
    assert url in told
    return told


def test_what_cannot_be_read_is_one_line(folder, home, capsys):
    with SftpServer(folder, USER) as server:
        url = f"{server.url}/bag"
        assert "is not in ~/.ssh/known_hosts: connect to it once with ssh" in refused(capsys, url)
        with SftpServer(folder, USER) as other:
            mine = server.known_host.split(" ")
            mine[2] = other.known_host.split(" ")[2]
        (home / ".ssh" / "known_hosts").write_text(" ".join(mine))
        assert "has another key than in ~/.ssh/known_hosts" in refused(capsys, url)
        known(server, home)
        assert "nothing: not found" in refused(capsys, f"{server.url}/nothing")
        assert "nothing.mcap: not found" in refused(capsys, f"{server.url}/nothing.mcap")
        assert server.connections == 3  # none of this was tried again
    assert "tried 4 times" in refused(capsys, f"{server.url}/other")  # it is off


def test_a_wrong_user_key_or_password_is_one_line(folder, home, capsys, monkeypatch):
    with SftpServer(folder, paramiko.ECDSAKey.generate()) as server:
        url = f"{known(server, home)}/bag"
        assert "accepts no key of this user" in refused(capsys, url)
        monkeypatch.setitem(conf, "sftp", {"password": "wrong"})
        assert "wrong" not in refused(capsys, url)


def often(fault, times):
    """The fault in so many of the large reads."""
    left = threading.Semaphore(times)

    def act(transport, data):
        if len(data) > 10_000 and left.acquire(blocking=False):
            fault(transport)

    return act


def cut(transport):
    transport.sock.close()
    transport.close()


def test_a_cut_connection_is_made_anew(folder, home):
    with SftpServer(folder, USER, often(cut, 2)) as server:
        path = bag_path(f"{known(server, home)}/bag/bag_0.mcap")
        assert messages(path) == messages(folder / "bag")
        assert server.connections == 3


@pytest.mark.parametrize(
    ("fault", "message"),
    [(cut, "tried 4 times"), (lambda _: time.sleep(1.0), "did not answer in time; tried 4 times")],
)
def test_what_fails_always_is_said_with_the_url(folder, home, monkeypatch, fault, message):
    monkeypatch.setattr(location, "TIMEOUT", 0.3)
    with SftpServer(folder, USER, often(fault, 10**6)) as server:
        url = f"{known(server, home)}/bag/bag_0.mcap"
        with pytest.raises(BagError, match=message) as found:
            messages(bag_path(url))
        assert f"{url}: " in str(found.value)
        assert "\n" not in str(found.value)
