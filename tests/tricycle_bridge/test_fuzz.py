"""A bounded run of the coverage-guided fuzzer; `make soak` runs 20 000."""

import os
import subprocess
import sys
from pathlib import Path

import pytest


@pytest.mark.slow
def test_a_bounded_fuzzing_run_finds_nothing():
    pytest.importorskip("atheris")
    harness = Path(__file__).with_name("fuzz_link.py")
    command = [
        sys.executable,
        str(harness),
        f"-runs={os.environ.get('FUZZ_RUNS', '2000')}",
        "-seed=1",
        "-max_len=2048",
        "-len_control=0",
        # The peak it would measure is that of the process that started it: Linux hands it on.
        "-rss_limit_mb=0",
    ]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-3000:]
