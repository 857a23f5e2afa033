"""Runs benchmarks, keeps what they print with its date and commit, and plots figures over time.

    python benchmarks/history.py run [NAME …]    # default: all; adds to benchmarks/history.jsonl
    python benchmarks/history.py plot [--output FILE]

Machines differ: a run notes its processor, and how busy the machine was before (`load`, processes
ready to run); the plot draws one curve for each processor. A figure is a
number in the output with the words of its line: lines that keep their words make a curve.
"""

import argparse
import json
import os
import platform
import re
import subprocess
import sys
import time
from collections import defaultdict
from datetime import UTC, datetime
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")
from matplotlib import pyplot as plt

FOLDER = Path(__file__).parent
HISTORY = FOLDER / "history.jsonl"
NUMBER = re.compile(r"(?<![\w.])-?\d+(?:\.\d+)?(?:e-?\d+)?(?![\w.]*\w)")


def processor():
    """Name of the processor."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor()
    names = [line.partition(": ")[2] for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor()


def run(names):
    """Run each benchmark, pass on what it prints, and add it to the history."""
    status = 0
    commit = subprocess.run(
        ["git", "describe", "--always", "--dirty"], cwd=FOLDER, capture_output=True, text=True
    ).stdout.strip()
    for name in names:
        print(f"== {name}", flush=True)
        began, load = time.monotonic(), os.getloadavg()[0]
        done = subprocess.run([sys.executable, FOLDER / name], stdout=subprocess.PIPE, text=True)
        print(done.stdout, end="", flush=True)
        if done.returncode:
            print(f"{name}: ended with status {done.returncode}; not kept", file=sys.stderr)
            status = 1
            continue
        entry = {
            "date": datetime.now(UTC).isoformat(timespec="seconds"),
            "commit": commit,
            "processor": processor(),
            "load": round(load, 1),
            "benchmark": name,
            "seconds": round(time.monotonic() - began, 1),
            "output": done.stdout.splitlines(),
        }
        with HISTORY.open("a") as file:
            file.write(json.dumps(entry) + "\n")
    return status


def figures(lines):
    """Numbers of an output: {words of the line and position: number}."""
    found = {}
    for line in lines:
        words = " ".join(NUMBER.sub("#", line).split())
        for position, number in enumerate(NUMBER.findall(line)):
            found.setdefault(f"{words} [{position}]", float(number))
    return found


def plot(output):
    """Every figure with a sign that is always the same, as a ratio to its first run."""
    entries = [json.loads(line) for line in HISTORY.read_text().splitlines()]
    by_benchmark = defaultdict(lambda: defaultdict(list))
    for entry in entries:
        for key, value in figures(entry["output"]).items():
            curve = by_benchmark[entry["benchmark"]][entry["processor"], key]
            curve.append((datetime.fromisoformat(entry["date"]), value))
    names = sorted(by_benchmark)
    size = (9, 2.6 * len(names))
    figure, axes = plt.subplots(
        len(names), 1, figsize=size, squeeze=False, sharex=True, layout="constrained"
    )
    for axis, name in zip(axes[:, 0], names, strict=True):
        for curve in by_benchmark[name].values():
            dates, values = zip(*curve, strict=True)
            if all(value > 0 for value in values):
                axis.plot(dates, [value / values[0] for value in values], ".-", alpha=0.5)
        axis.set(title=name, yscale="log", ylabel="ratio to first run")
        axis.grid(alpha=0.3)
    figure.autofmt_xdate()
    figure.savefig(output, dpi=120)
    print(f"{len(entries)} runs of {len(names)} benchmarks: {output}")


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    verbs = parser.add_subparsers(dest="verb", required=True)
    verbs.add_parser("run").add_argument("names", nargs="*")
    drawing = verbs.add_parser("plot").add_argument
    drawing("--output", type=Path, default=FOLDER.parent / "out" / "bench.png")
    args = parser.parse_args()
    if args.verb == "run":
        known = sorted(p.name for p in FOLDER.glob("*.py") if p != Path(__file__))
        names = [f"{name.removesuffix('.py')}.py" for name in args.names] or known
        if unknown := sorted(set(names) - set(known)):
            parser.error(f"no benchmark {', '.join(unknown)}; there are: {', '.join(known)}")
        return run(names)
    if not HISTORY.exists():
        parser.error(f"{HISTORY} does not exist: run benchmarks first")
    args.output.parent.mkdir(parents=True, exist_ok=True)
    plot(args.output)
    return 0


if __name__ == "__main__":
    sys.exit(main())
