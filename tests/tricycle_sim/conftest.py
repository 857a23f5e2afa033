"""The firmware's C logic, compiled once per run for every test that compares with it."""

import shutil
import subprocess
from pathlib import Path

import pytest

FIRMWARE = Path(__file__).parents[2] / "firmware"


@pytest.fixture(scope="session")
def firmware_libraries(tmp_path_factory) -> Path:
    if shutil.which("cc") is None:
        pytest.skip("no C compiler: the firmware's logic is not tested here")
    build = tmp_path_factory.mktemp("firmware")
    subprocess.run(["make", "-s", "-C", FIRMWARE, "host", f"BUILD={build}"], check=True)
    return build
