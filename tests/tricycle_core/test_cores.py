"""The cores that `taskset` or a scheduler leaves to a process."""

import os

from tricycle_core.cores import usable_cores


def test_cores_that_are_kept_from_a_process_are_not_counted():
    cores = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(cores)})
    try:
        assert usable_cores() == 1
    finally:
        os.sched_setaffinity(0, cores)
