"""Bags behind URLs: the same messages as from here, few bytes, and no short bag by a bad answer."""

import shutil
import sys
import threading
from itertools import count

import numpy as np
import pytest
from camera_bag import WANTED, write_camera_bag
from driven_bags import VEHICLE, SimulatedBag
from web_server import WebServer

from parameter_identification.drives.kept import content_key
from parameter_identification.drives.measured_from_bag import read_measured_drive
from trajectory_recorder.bag import location, remote
from trajectory_recorder.bag.location import bag_path
from trajectory_recorder.bag.reader import BagReader
from tricycle_cli.main import main
from tricycle_core.errors import BagError

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with a bag of 40 s: a camera, and a small topic that is wanted."""
    folder = tmp_path_factory.mktemp("store")
    write_camera_bag(folder / "bag", 40)
    return folder


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    monkeypatch.setattr(remote, "PAUSE", 0.001)
    monkeypatch.setattr(location, "TIMEOUT", 0.5)


def here(folder):
    with BagReader(folder / "bag") as bag:
        return list(bag.messages()), bag.metadata, bag.topics, bag.span, bag.size


def there(url):
    with BagReader(bag_path(url)) as bag:
        return list(bag.messages()), bag.metadata, bag.topics, bag.span, bag.size


def test_a_bag_on_a_web_server_is_read_as_from_here(folder):
    with WebServer(folder) as server:
        assert there(f"{server.url}/bag") == here(folder)
        assert there(f"{server.url}/bag/bag_0.mcap") == here(folder)


@pytest.mark.parametrize(
    "key",
    [
        *("ETag", "etag", "LastModified", "last_modified", "Last-Modified", "Content-MD5"),
        *("content_md5", "md5Hash", "generation", "mtime"),
    ],
)
def test_the_state_of_a_file_is_what_any_store_calls_it(key):
    class Store:
        def invalidate_cache(self): ...

        def info(self, path):
            return {"name": path, "size": 10, key: self.told}

    class File:
        suffix, path, fs = ".mcap", "store/a.mcap", Store()

    Store.told = "before"
    before = remote.remote_state(File)
    assert before == remote.remote_state(File)
    Store.told = "after"
    assert before != remote.remote_state(File)


def test_only_the_chunks_of_wanted_topics_are_fetched(folder):
    with WebServer(folder) as server, BagReader(bag_path(f"{server.url}/bag")) as bag:
        assert len(list(bag.messages([WANTED]))) == 400
        assert bag.size > 8e6
        assert bag.fetched < 0.03 * bag.size
        assert server.sent < bag.fetched + 10_000  # metadata.yaml


def test_a_bag_in_an_object_store_is_identified_from(tmp_path, monkeypatch):
    from moto.server import ThreadedMotoServer

    bag = SimulatedBag().write(tmp_path / "drive")
    server = ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    server.start()
    try:
        host, port = server.get_host_and_port()
        monkeypatch.setenv("AWS_ENDPOINT_URL", f"http://{host}:{port}")
        for name in ("AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY"):
            monkeypatch.setenv(name, "of the test")
        monkeypatch.setenv("AWS_DEFAULT_REGION", "us-east-1")
        store = bag_path("s3://drives/2026").fs
        store.mkdir("drives")
        store.put(str(bag), "drives/2026/drive", recursive=True)
        path = bag_path("s3://drives/2026/drive")
        found, local = read_measured_drive(path, VEHICLE), read_measured_drive(bag, VEHICLE)
        assert found.name == "drive"
        for sensor, signal in local.signals.items():
            np.testing.assert_array_equal(found.signals[sensor].values, signal.values)
        key = content_key(path, VEHICLE)
        assert key == content_key(path, VEHICLE)
        (bag / "metadata.yaml").unlink()  # as a killed recorder leaves it: listed then
        store.rm("drives/2026/drive/metadata.yaml")
        assert len(read_measured_drive(path, VEHICLE).signals) == len(local.signals)
        with pytest.raises(BagError, match="s3://drives/2026/other: not found"):
            BagReader(bag_path("s3://drives/2026/other"))
    finally:
        server.stop()


def test_a_torn_bag_is_read_up_to_its_tear(folder, tmp_path):
    (tmp_path / "bag").mkdir()
    whole = (folder / "bag" / "bag_0.mcap").read_bytes()
    (tmp_path / "bag" / "bag_0.mcap").write_bytes(whole[: len(whole) // 2])
    with WebServer(tmp_path) as server:
        url = f"{server.url}/bag/bag_0.mcap"
        assert there(url) == here(tmp_path)
        with BagReader(bag_path(url)) as bag:
            assert not bag.complete


def often(fault, times):
    """The fault in so many of the first answers."""
    left = threading.Semaphore(times)

    def answer(handler, data):
        if not left.acquire(blocking=False):
            return False
        fault(handler, data)
        return True

    return answer


def cut(handler, data):
    handler.head(206, len(data), f"bytes 0-{len(data) - 1}/{len(data)}")
    handler.wfile.write(data[: len(data) // 2])
    handler.close_connection = True


def short(handler, data):
    handler.head(206, len(data) // 2, f"bytes 0-{len(data) // 2 - 1}/{len(data)}")
    handler.wfile.write(data[: len(data) // 2])


def silent(handler, data):
    handler.head(206, len(data), f"bytes 0-{len(data) - 1}/{len(data)}")
    handler.wfile.flush()
    threading.Event().wait(1.0)  # longer than TIMEOUT


def overloaded(handler, data):
    handler.send_error(503)


FAULTS = {
    cut: "not completed|payload",
    short: "bytes in place of",
    silent: "did not answer in time|imeout",
    overloaded: "503",
}


@pytest.mark.parametrize("fault", FAULTS)
def test_what_fails_twice_is_asked_for_again(folder, fault):
    with WebServer(folder, often(fault, 2)) as server:
        assert there(f"{server.url}/bag/bag_0.mcap") == here(folder)


@pytest.mark.parametrize(("fault", "message"), FAULTS.items())
def test_what_fails_always_is_said_with_the_url(folder, fault, message):
    with WebServer(folder, often(fault, 100)) as server:
        with pytest.raises(BagError, match=message) as found:
            there(f"{server.url}/bag/bag_0.mcap")
        assert f"{server.url}/bag/bag_0.mcap: " in str(found.value)
        assert "tried 4 times" in str(found.value)


def test_changed_bytes_are_a_damaged_chunk(folder):
    def changed(handler, data):
        data = bytearray(data)
        data[len(data) // 2] ^= 1
        handler.head(206, len(data), f"bytes 0-{len(data) - 1}/{len(data)}")
        handler.wfile.write(data)
        return True

    with (
        WebServer(folder, lambda h, d: len(d) > 2**17 and changed(h, d)) as server,
        pytest.raises(BagError, match="damaged at byte"),
    ):
        there(f"{server.url}/bag/bag_0.mcap")


@pytest.mark.parametrize("seconds", [10, 50], ids=["damage", "the same so far"])
def test_a_bag_that_changes_while_it_is_read_is_said(folder, tmp_path, seconds):
    shutil.copytree(folder / "bag", tmp_path / "bag")
    write_camera_bag(tmp_path / "other", seconds)
    file, chunks = tmp_path / "bag" / "bag_0.mcap", count()

    def answer(*_):
        if next(chunks) == 5:
            file.write_bytes((tmp_path / "other" / "other_0.mcap").read_bytes())
        return False

    with (
        WebServer(tmp_path, answer) as server,
        BagReader(bag_path(f"{server.url}/bag/bag_0.mcap")) as bag,
        pytest.raises(BagError, match=r"bag_0\.mcap: changed while it was read"),
    ):
        list(bag.messages([WANTED]))


def test_a_server_without_parts_of_files_is_said(folder):
    with (
        WebServer(folder, ranges=False) as server,
        pytest.raises(BagError, match="range"),
    ):
        there(f"{server.url}/bag/bag_0.mcap")


@pytest.mark.parametrize(
    ("url", "message"),
    [
        ("{server}/nothing.mcap", "nothing.mcap: not found"),
        ("{server}/nothing", "nothing: not found"),
        ("{server}/other", "only those are read from elsewhere"),
        ("http://127.0.0.1:9/bag.mcap", "Cannot connect"),
        ("s4://bucket/bag", "s4"),
        ("https://me:secret@host/bag", "no password in a URL"),
        ("sftp://me:secret/too@host/bag", "no password in a URL"),
        ("sftp://me:secret@too@host/bag", "no password in a URL"),
        ("https://host/bag.mcap?X-Amz-Signature=1", "no query in a URL"),
    ],
)
def test_a_wrong_url_is_one_line(tmp_path, capsys, url, message):
    (tmp_path / "other").mkdir()
    text = "rosbag2_bagfile_information: {relative_file_paths: [other_0.db3]}"
    (tmp_path / "other" / "metadata.yaml").write_text(text)
    with WebServer(tmp_path) as server, pytest.raises(SystemExit, match="2"):
        sys.exit(main(["bag", "info", url.format(server=server.url)]))
    told = capsys.readouterr().err
    assert told.count("\n") == 1
    assert message in told
    assert "secret" not in told
    assert "Signature" not in told


def test_a_server_that_fails_is_no_missing_file(folder):
    with (
        WebServer(folder, down=True) as server,
        pytest.raises(BagError, match=r"bag: 503.*tried 4 times"),
    ):
        there(f"{server.url}/bag")


def test_what_was_fetched_is_said(folder, capsys):
    with WebServer(folder) as server:
        assert main(["bag", "info", f"{server.url}/bag"]) == 0
    assert "MB fetched)" in capsys.readouterr().out


def test_a_table_behind_a_url_is_refused(capsys):
    assert main(["identify", "https://host/drive.csv"]) == 2
    assert "download the table" in capsys.readouterr().err
