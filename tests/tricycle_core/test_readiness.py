from hypothesis import given
from hypothesis import strategies as st

from tricycle_core.readiness import Readiness


@given(armed=st.booleans(), reason=st.text(), commander=st.text(), refused=st.text())
def test_what_is_written_is_read(armed, reason, commander, refused):
    readiness = Readiness(armed, reason, commander, refused)
    assert Readiness.from_values(readiness.values()) == readiness


def test_a_message_without_values_is_not_armed():
    assert not Readiness.from_values({}).armed
