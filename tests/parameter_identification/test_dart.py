"""The benchmark on DART's real drives, where its recordings are there (`DART_DATA`)."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

BENCHMARK = Path(__file__).parents[2] / "benchmarks/dart.py"
DATA = os.environ.get("DART_DATA", "")


@pytest.mark.slow
@pytest.mark.skipif(not DATA, reason="DART_DATA does not name the folder of DART's recordings")
def test_drives_are_predicted_better_than_by_the_authors_model() -> None:
    command = [sys.executable, str(BENCHMARK), "--data", DATA, "--json"]
    command += ["--fit", "ramp_pos02", "ramp_neg02", "--predict"]
    command += [f"{DATA}/{name}.csv.gz" for name in ("ramp_pos025", "lap_1_0")]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    found = json.loads(done.stdout)
    inertia = found["parameters"]["yaw_inertia"]
    assert (
        not inertia["shown"] or inertia["low"] < 0.0048 < inertia["high"]
    )  # the authors' estimate
    for name, prediction in found["predictions"].items():
        for horizon, ours in prediction["ours"].items():
            for quantity, value in ours.items():
                assert value < prediction["authors"][horizon][quantity], (name, horizon, quantity)
