"""Compiled code is kept on disk where that is possible, and works where it is not."""

import logging
import os
import subprocess
import sys

import numba
import pytest

from tricycle_sim import compilation

FIRST_RUN = """
import logging, time
logging.basicConfig(level=logging.INFO, format="%(message)s")
import numpy as np
from tricycle_sim.setpoints import slew_all
start = time.process_time()
slew_all(np.zeros(3), 1.0)
print(time.process_time() - start)
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
    assert "compiling the vehicle model for this machine" in "".join(outputs)
    assert list(tmp_path.rglob("*.nbc"))
    output, _ = start(tmp_path).communicate(timeout=120)
    assert "compiling" not in output
    assert float(output) < 1.0


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
