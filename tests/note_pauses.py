"""Print the pauses of one processor of this machine [s]; started by stalls.py."""

import os
import sys
import time

PAUSE = 0.1  # s
PERIOD = 0.01  # s


def main(cpu: int) -> None:
    """Run on that processor until killed; print how late it was when it was late."""
    os.sched_setaffinity(0, {cpu})
    print(0.0, flush=True)
    before = time.monotonic()
    while True:
        time.sleep(PERIOD)
        now = time.monotonic()
        if (pause := now - before - PERIOD) >= PAUSE:
            print(f"{pause:.3f}", flush=True)
        before = now


if __name__ == "__main__":
    main(int(sys.argv[1]))
