"""Child processes and signals."""

import signal

import pytest

from tricycle_bringup.processes import interrupts_held


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
