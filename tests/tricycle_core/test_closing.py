"""A resource is closed when its block ends, however it ends."""

import pytest

from tricycle_core.closing import Closing


class Port(Closing):
    closed = 0

    def close(self):
        self.closed += 1


def test_the_block_closes_it_and_hands_on_what_was_raised():
    with Port() as port:
        assert not port.closed
    assert port.closed == 1

    def fail():
        with port:
            raise KeyError

    with pytest.raises(KeyError):
        fail()
    assert port.closed == 2
