"""The processor cores that this process may use."""

import os


def usable_cores() -> int:
    """Return their number, which `taskset`, a container or a cluster's scheduler may limit."""
    return len(os.sched_getaffinity(0))
