"""The figures of docs/model.md are those that the checks print."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
NUMBER = re.compile(r"[+-]?\d+(?:\.\d+)?(?:e[+-]?\d+)?")


@pytest.mark.slow
def test_the_page_has_the_figures_that_the_checks_print():
    command = [sys.executable, ROOT / "benchmarks" / "vehicle_checks.py"]
    run = subprocess.run(command, check=True, capture_output=True, text=True)
    page = (ROOT / "docs" / "model.md").read_text(encoding="utf-8").splitlines()
    printed_lines = run.stdout.splitlines()
    begin = page.index("`python benchmarks/vehicle_checks.py` prints:") + 2
    assert len(printed_lines) == page.index("", begin) - begin
    for line in printed_lines:
        check = line[:62].rstrip()
        (quoted,) = [text.strip() for text in page if text.startswith("    " + check)]
        printed, there = (
            [float(number) for number in NUMBER.findall(text)] for text in (line, quoted)
        )
        # round-off depends on the processor
        assert there == pytest.approx(printed, rel=0.02, abs=1e-11), check
