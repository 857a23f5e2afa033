"""Print the pauses of one processor of this machine [s]; started by stalls.py.

A pause is a time in which this process wanted to run and did not, or what the host of a virtual
machine has taken of the processor within WINDOW.
"""

import os
import sys
import time
from pathlib import Path

PAUSE = 0.05  # s: a command passes four processes and threads, and boards wait for 0.2 s
PERIOD = 0.01  # s
WINDOW = 0.3  # s
_JIFFY = 1.0 / os.sysconf("SC_CLK_TCK")  # s


def taken(cpu: int) -> float:
    """Return for how long the processor has run something else than this machine [s]."""
    lines = Path("/proc/stat").read_text("ascii").splitlines()
    (fields,) = (line.split() for line in lines if line.startswith(f"cpu{cpu} "))
    return int(fields[8]) * _JIFFY


def main(cpu: int) -> None:
    """Run on that processor until killed; print how late it was when it was late."""
    os.sched_setaffinity(0, {cpu})
    print(0.0, flush=True)
    before = looked = time.monotonic()
    lost = taken(cpu)
    while True:
        time.sleep(PERIOD)
        now = time.monotonic()
        pause = now - before - PERIOD
        before = now
        if now - looked >= WINDOW:
            pause = max(pause, taken(cpu) - lost)
            looked, lost = now, taken(cpu)
        if pause >= PAUSE:
            print(f"{pause:.3f}", flush=True)


if __name__ == "__main__":
    main(int(sys.argv[1]))
