"""Module names that documentation showed import the modules of today, in any order, and say so."""

import os
import subprocess
import sys

import pytest

LOOK = """
import importlib, sys, warnings
from tricycle_core.renamed import RENAMED
for old, new in RENAMED.items():
    if sys.argv[1] == "new first":
        importlib.import_module(new)
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        found = importlib.import_module(old)
    assert any(f"{old} is {new} now" in str(w.message) for w in warned), old
    assert found is importlib.import_module(new), old
    package, _, name = old.rpartition(".")
    assert getattr(sys.modules[package], name) is sys.modules[new], old
"""


@pytest.mark.slow
@pytest.mark.parametrize("order", ["old first", "new first"])
def test_an_old_name_is_the_module_of_today(order):
    pytest.importorskip("rclpy")
    environment = {**os.environ, "NUMBA_DISABLE_JIT": "1"}  # nothing is compiled for this
    subprocess.run([sys.executable, "-c", LOOK, order], check=True, env=environment)
