"""Child processes and signals."""

import signal
from concurrent.futures import ThreadPoolExecutor

import pytest

from tricycle_cli.operation.processes import interrupts_held


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupt_waits_for_what_is_under_way(number):
    before = signal.getsignal(number)
    steps = []

    def interrupted():
        with interrupts_held():
            signal.raise_signal(number)
            steps.append("done")

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert steps == ["done"]
    assert signal.getsignal(number) is before


def test_another_thread_is_never_interrupted():
    def step():
        with interrupts_held():
            return "done"

    with ThreadPoolExecutor() as pool:
        assert pool.submit(step).result() == "done"
