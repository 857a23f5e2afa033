"""The same design on dask: a real scheduler and workers in processes of their own, over TCP."""

import os
import shutil
import signal
import subprocess
import sys
import time
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import numpy as np
import pytest

import tricycle_core
from excitation_planner import design_excitation
from tricycle_core.errors import DesignError

distributed = pytest.importorskip("distributed")

# dask's own warnings
pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("default")]

SCHEDULER = "distributed.cli.dask_scheduler --host 127.0.0.1 --port 0 --no-dashboard"
WORKER = "distributed.cli.dask_worker --nthreads 1 --no-nanny --no-dashboard"


class Cluster:
    """A scheduler, and workers that come and go."""

    def __init__(self, folder: Path) -> None:
        self.file, self.processes = folder / "scheduler.json", []
        self._start(SCHEDULER, {})
        deadline = time.monotonic() + 60
        while not self.file.exists() and time.monotonic() < deadline:
            time.sleep(0.1)

    def worker(self, **environment):
        return self._start(WORKER, environment)

    def _start(self, command, environment):
        process = subprocess.Popen(
            [sys.executable, "-m", *command.split(), "--scheduler-file", str(self.file)],
            env=os.environ | {"OMP_NUM_THREADS": "1"} | environment,
            stderr=subprocess.DEVNULL,
        )
        self.processes.append(process)
        return process


@contextmanager
def cluster_of(workers, folder):
    cluster = Cluster(folder)
    try:
        for _ in range(workers):
            cluster.worker()
        with distributed.Client(scheduler_file=str(cluster.file)) as client:
            if workers:
                client.wait_for_workers(workers, timeout=60)
            yield cluster, client
    finally:
        for process in cluster.processes:
            process.kill()
            process.wait()


def output(x, P):
    return P[:, 0] * np.exp(-P[:, 1]) + (0.1 + np.sin(x[0]) ** 2) * P[:, 1]


def must_not_run(x, P, marker):
    marker.touch()


def small_design(f=output, **arguments):
    box = {"p": (0.0, 1.0), "q": (0.0, 1.0)}
    return design_excitation(f, {"x": (-1.0, 1.0)}, box, "p", samples=8, budget=260, **arguments)


def assert_same(one, other):
    assert np.array_equal(one.x, other.x)
    assert one.cost == other.cost
    assert [e.cost for e in one.history] == [e.cost for e in other.history]


def test_workers_that_come_and_go(tmp_path, caplog):
    """One is killed, one comes late; the simulations of a maneuver are spread over them."""
    with cluster_of(2, tmp_path) as (cluster, client):
        events = []

        def come_and_go(done, total):
            if done > 60 and not events:
                events.append(cluster.processes[1].kill())
                events.append(cluster.worker())

        found = small_design(executor=client.get_executor(), chunk=3, progress=come_and_go)
        assert events
    assert_same(found, small_design(workers=1))
    assert any(message.startswith("dask lost worker tcp://") for message in caplog.messages)


def test_a_result_that_dies_with_its_worker_is_asked_for_again(tmp_path, caplog, monkeypatch):
    """What distributed's future raises then: it unpacks an error that is not there."""
    with cluster_of(1, tmp_path) as (_, client):
        executor, lost = client.get_executor(), []
        hand_in = executor.submit

        def submit(*arguments):
            future = hand_in(*arguments)
            if not lost:
                lost.append(future)
                monkeypatch.setattr(future, "result", partial(int, "not enough values to unpack"))
            return future

        monkeypatch.setattr(executor, "submit", submit)
        found = small_design(executor=executor)
    assert_same(found, small_design(workers=1))
    assert any(
        message.startswith("dask lost a result with its worker; ") for message in caplog.messages
    )


def test_tasks_of_a_stopped_worker_are_done_by_another(tmp_path, caplog):
    """Its connexion stays open: nothing but the time tells."""
    with cluster_of(2, tmp_path) as (cluster, client):
        stopped = []

        def stop_one(done, total):
            if done > 60 and not stopped:
                stopped.append(cluster.processes[1].send_signal(signal.SIGSTOP))

        found = small_design(executor=client.get_executor(), timeout=5, progress=stop_one)
        assert stopped
    assert_same(found, small_design(workers=1))
    assert any(message.startswith("no result for 5 s; ") for message in caplog.messages)


def test_a_worker_of_another_version_gets_no_work(tmp_path):
    """It is started with an older copy of the package that has the version."""
    older, marker = tmp_path / "older" / "tricycle_core", tmp_path / "ran"
    shutil.copytree(Path(tricycle_core.__file__).parent, older)
    text = (older / "__init__.py").read_text()
    (older / "__init__.py").write_text(text.replace(tricycle_core.__version__, "0.0.9"))
    with cluster_of(0, tmp_path) as (cluster, client):
        cluster.worker(PYTHONPATH=str(older.parent))
        client.wait_for_workers(1, timeout=60)
        with pytest.raises(DesignError, match=r"has tricycle-excitation 0\.0\.9 instead of "):
            small_design(partial(must_not_run, marker=marker), executor=client.get_executor())
    assert not marker.exists()
