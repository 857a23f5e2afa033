"""Compiled code is kept on disk where that is possible, and works where it is not."""

import logging
import os
import subprocess
import sys
from typing import NamedTuple

import numba
import pytest

from tricycle_sim import compilation
from tricycle_sim.vehicle.laws import inlined

FIRST_RUN = """
import logging, sys, time
logging.basicConfig(level=logging.INFO, format="%(message)s")
import numpy as np
from tricycle_sim.setpoints import slew_all
start = time.process_time()
slew_all(np.zeros(3), 1.0)
print(time.process_time() - start, *({"scipy.linalg"} & sys.modules.keys()))
"""


def start(cache):
    return subprocess.Popen(
        [sys.executable, "-c", FIRST_RUN],
        env={**os.environ, "NUMBA_CACHE_DIR": str(cache)},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )


@pytest.mark.slow
def test_compiled_code_is_kept_in_the_folder_that_was_named(tmp_path):
    # two at a time, as the processes of a demo start
    processes = [start(tmp_path) for _ in range(2)]
    outputs = [process.communicate(timeout=120)[0] for process in processes]
    assert [process.returncode for process in processes] == [0, 0], outputs
    assert "compiling the vehicle model for this command" in "".join(outputs)
    assert list(tmp_path.rglob("*.nbc"))
    output, _ = start(tmp_path).communicate(timeout=120)
    assert "compiling" not in output
    # nor is what numba needs for compiling, SciPy among it, imported for loading
    assert float(output) < 0.5


def test_without_a_writable_folder_every_process_compiles_for_itself(monkeypatch, caplog):
    original = numba.njit

    def refuse(function, **options):
        if options.get("cache"):
            raise RuntimeError("cannot cache function: no locator available")
        return original(function, **options)

    monkeypatch.setattr(numba, "njit", refuse)

    def double(x):
        return 2.0 * x

    with caplog.at_level(logging.WARNING):
        assert compilation.compiled(double)(3.0) == 6.0
    assert "set NUMBA_CACHE_DIR" in caplog.text


@pytest.mark.skipif(
    not compilation.llvm.get_host_cpu_features().get("avx512f"), reason="no AVX-512 here"
)
def test_512_bit_vectors_are_asked_for():
    assert numba.config.CPU_FEATURES.endswith("-prefer-256-bit")


def halved(x):
    return FACTOR * x


FACTOR = 0.5


def test_numba_keeps_a_source_stamp_that_can_be_extended(tmp_path, monkeypatch):
    """`compiled` writes to `dispatcher._cache._cache_file._source_stamp`, private to numba."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    numba.config.reload_config()
    try:
        plain, ours = numba.njit(halved, cache=True), compilation.compiled(halved)
        again = compilation.compiled(halved)
    finally:
        monkeypatch.undo()
        numba.config.reload_config()
    why = f"numba {numba.__version__} keeps its cache in another way: adapt compilation.compiled"
    cache_file = getattr(getattr(plain, "_cache", None), "_cache_file", None)
    assert hasattr(cache_file, "_source_stamp"), why
    stamp = ours._cache._cache_file._source_stamp
    assert stamp[0] == cache_file._source_stamp, why
    assert "'FACTOR': 0.5" in stamp[2]
    assert ours(3.0) == 1.5
    assert again(3.0) == 1.5
    assert (sum(ours.stats.cache_hits.values()), sum(again.stats.cache_hits.values())) == (0, 1), (
        why
    )
    ours._cache._cache_file.save("key", "data")
    assert ours._cache._cache_file.load("key") == "data", why
    ours._cache._cache_file._source_stamp = (*stamp[:1], "other sources", *stamp[2:])
    assert ours._cache._cache_file.load("key") is None, why


def test_numba_announces_what_it_compiles():
    """`compilation` listens to numba.core.event, which is not documented as stable."""
    from numba.core import event

    with event.install_recorder("numba:compile") as recorder:
        numba.njit(halved)(1.0)
    (started, _), *_ = [(e, t) for t, e in recorder.buffer if e.is_start]
    why = f"numba {numba.__version__} announces compilation in another way: adapt _Announcement"
    assert started.data["dispatcher"].py_func is halved, why


def test_llvmlite_names_the_features_of_the_processor():
    """`compilation` asks llvmlite for them and hands them to numba.config.CPU_FEATURES."""
    features = compilation.llvm.get_host_cpu_features()
    assert isinstance(features, dict), "llvmlite gives the features in another way"
    assert features.flatten().startswith(("+", "-")), "llvmlite writes features in another way"
    assert hasattr(numba.config, "CPU_FEATURES"), "numba takes the features from elsewhere"
    assert hasattr(numba.config, "CPU_NAME"), "numba takes the processor from elsewhere"


def test_a_template_is_compiled_with_other_functions_in_place_of_its_names():
    variant = compilation.compiled(halved, "quarter", FACTOR=0.25)
    assert variant(4.0) == 1.0
    assert compilation.compiled(halved)(4.0) == 2.0
    assert "quarter" in variant.py_func.__qualname__


class Rows(NamedTuple):
    softness: int


ROWS = Rows(2)


@inlined
def softness(x):
    return ROWS.softness * x


def softened(x):
    return softness(x)


@pytest.mark.slow
def test_a_law_may_have_the_name_of_a_row_that_it_reads():
    assert compilation.compiled(softened)(4.0) == 8.0


def test_all_modules_of_the_vehicle_are_in_the_fingerprint():
    names = {path.name for path in compilation.sources()}
    assert {"kernel.py", "tyre.py", "actuators.py", "layout.py", "timing.py"} <= names
    assert all(path.is_file() for path in compilation.sources())
