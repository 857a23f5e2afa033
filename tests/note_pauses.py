"""Print every pause in which this process wanted to run and did not [s]; started by stalls.py."""

import time

PAUSE = 0.1  # s
PERIOD = 0.01  # s


def main() -> None:
    """Run until killed."""
    print(0.0, flush=True)
    before = time.monotonic()
    while True:
        time.sleep(PERIOD)
        now = time.monotonic()
        if (pause := now - before - PERIOD) >= PAUSE:
            print(f"{pause:.3f}", flush=True)
        before = now


if __name__ == "__main__":
    main()
