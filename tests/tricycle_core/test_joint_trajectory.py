"""Rows of the commands' message."""

from types import SimpleNamespace

import pytest

from tricycle_core.joint_trajectory import rows_of
from tricycle_core.joints import JOINTS


def message(names, *rows):
    points = [
        SimpleNamespace(
            time_from_start=SimpleNamespace(sec=sec, nanosec=0), positions=p, velocities=v
        )
        for sec, p, v in rows
    ]
    return SimpleNamespace(joint_names=names, points=points)


def test_joints_are_found_by_name():
    steer, wheel = JOINTS
    assert rows_of(message([wheel, steer], (1, (7.0, 0.1), (2.0, 8.0)))).tolist() == [[1, 0.1, 2]]
    assert rows_of(message(JOINTS)).shape == (0, 3)


def test_a_missing_joint_or_value_is_an_error():
    with pytest.raises(ValueError, match=JOINTS[1]):
        rows_of(message(JOINTS[:1]))
    with pytest.raises(IndexError):
        rows_of(message(JOINTS, (0, (0.0,), (0.0,))))
