"""What the driver says is what its readers hear."""

import pytest

from tricycle_core.maneuver_state import ManeuverState, PlaybackState


@pytest.mark.parametrize(
    "state",
    [
        ManeuverState(PlaybackState.WAITING),
        ManeuverState(PlaybackState.RUNNING, "p1", 1_700_000_000_000_000_001, 0.25, 8.5),
        ManeuverState(PlaybackState.ABORTED, "p1", 0, 8.0, 8.5, "no pose"),
    ],
)
def test_what_is_said_is_heard(state):
    assert ManeuverState.from_values(state.values()) == state


@pytest.mark.parametrize(
    "values",
    [
        {},
        {"state": "flying"},
        {"state": "running", "start_time": "soon"},
        {"state": "running", "start_time": "9" * 30},
        {"state": "running", "duration": "long"},
        {"state": "running", "duration": "inf"},
    ],
)
def test_what_the_driver_never_says_is_refused(values):
    with pytest.raises(ValueError, match=r"."):
        ManeuverState.from_values(values)
