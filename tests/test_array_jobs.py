"""The script for sites without dask, run with plain processes."""

import importlib.util
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from excitation_planner import design_excitation

SCRIPT = Path(__file__).parents[1] / "deploy" / "array_jobs" / "array_jobs.sh"


@pytest.mark.slow
def test_tasks_that_died_are_repeated_and_the_design_is_that_of_one_process(tmp_path):
    programs = tmp_path / "programs"  # without Slurm, also where there is one
    programs.mkdir()
    for name in ("dirname", "seq", "wc"):
        (programs / name).symlink_to(shutil.which(name))
    source = SCRIPT.with_name("study.py").read_text()
    small = "draws=2, samples=8, budget=250"
    source = source.replace("draws=4, samples=20, budget=1200", small)
    # the second task of the first round is killed after a few simulations
    dies = (
        "    import os, signal\n"
        '    if "simulate" in sys.argv and sys.argv[3] == "2" and not Path("died").exists():\n'
        '        Path("died").touch()\n'
        "        os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    docstring = re.search(r'def simulate\(x, P\):\n    """.*"""\n', source).group()
    (tmp_path / "study.py").write_text(source.replace(docstring, docstring + dies))
    shutil.copy(SCRIPT, tmp_path)
    ran = subprocess.run(
        ["/bin/sh", tmp_path / SCRIPT.name, tmp_path / "study", "2"],
        cwd=tmp_path,
        env={"PATH": str(programs), "PYTHON": sys.executable, "OMP_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert (ran.returncode, ran.stderr) == (0, "")
    assert (tmp_path / "died").exists()

    specification = importlib.util.spec_from_file_location("array_study", tmp_path / "study.py")
    adapted = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(adapted)
    problem = adapted.create(tmp_path / "other")._store.problem
    design = design_excitation(
        adapted.simulate,
        problem.operation,
        problem.unknown,
        problem.target,
        criterion=problem.criterion,
        draws=problem.draws,
        samples=problem.samples,
        budget=problem.budget,
        workers=1,
    )
    assert ran.stdout.endswith(f"{design!r}\n")
    assert re.match(r"\d+ simulations\n", ran.stdout)
