"""The equations are compiled for eight vehicles at once, not for one after the other."""

import platform
import re
import shutil
import subprocess

import numba
import numpy as np
import pytest

from tricycle_sim.commands import Commands
from tricycle_sim.vehicle import load_vehicle
from tricycle_sim.vehicle.batch import simulate
from tricycle_sim.vehicle.kernel import functions_for

ARITHMETIC = re.compile(r"\bv?(?:add|sub|mul|div|fn?m(?:add|sub)\d+)(pd|sd)\b")


@pytest.mark.skipif(
    platform.machine() != "x86_64" or shutil.which("objdump") is None or numba.config.DISABLE_JIT,
    reason="reads the machine code of x86-64 with objdump",
)
def test_the_kernel_computes_with_vectors(tmp_path):
    """A condition that the compiler cannot turn into arithmetic makes all of it scalar."""
    vehicle = load_vehicle()
    simulate(vehicle, Commands([0.0, 0.02], [0.0, 0.0], np.ones(2)))
    (code,) = functions_for(vehicle).advance.overloads.values()
    file = tmp_path / "kernel.o"
    file.write_bytes(code.library._get_compiled_object())
    disassembly = subprocess.run(
        ["objdump", "-d", "--no-show-raw-insn", file], capture_output=True, text=True, check=True
    ).stdout
    found = [match.group(1) for match in ARITHMETIC.finditer(disassembly)]
    # the loop over the lanes, and once more what would do the rest of a number that is not eight
    assert found.count("pd") > 0.8 * found.count("sd") > 300
