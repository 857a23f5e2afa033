"""Quaternions and angles against SciPy's."""

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tricycle_core.rotations import (
    attitude_quaternion,
    is_unit,
    pitch_angle,
    roll_angle,
    yaw_angle,
    yaw_of,
)

angles = st.tuples(st.floats(-3.1, 3.1), st.floats(-1.5, 1.5), st.floats(-3.1, 3.1))


@given(angles)
def test_quaternions_are_those_of_scipy(rpy):
    roll, pitch, yaw = rpy
    x, y, z, w = Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_quat()
    ours = np.array(attitude_quaternion(roll, pitch, yaw))
    assert ours @ [w, x, y, z] == pytest.approx(np.sign(ours @ [w, x, y, z]), abs=1e-12)
    found = [angle(ours) for angle in (roll_angle, pitch_angle, yaw_angle)]
    assert found == pytest.approx(rpy, abs=1e-7)
    q = SimpleNamespace(w=w, x=x, y=y, z=z)
    assert yaw_of(q) == pytest.approx(yaw, abs=1e-7)


def test_many_quaternions_at_once():
    q = np.array([attitude_quaternion(0.1, 0.2, yaw) for yaw in (0.3, 0.4)]).T
    assert roll_angle(q) == pytest.approx([0.1, 0.1])
    assert pitch_angle(q) == pytest.approx([0.2, 0.2])
    assert yaw_angle(q) == pytest.approx([0.3, 0.4])


@pytest.mark.parametrize(
    ("q", "unit"),
    [
        ((1.0, 0.0, 0.0, 0.0), True),
        ((0.6, 0.0, 0.0, 0.803), True),
        ((0.0, 0.0, 0.0, 0.0), False),
        ((float("nan"), 0.0, 0.0, 1.0), False),
        ((1e300, 0.0, 0.0, 1e300), False),
    ],
)
def test_an_orientation_is_a_unit_quaternion(q, unit):
    assert is_unit(SimpleNamespace(**dict(zip("wxyz", q, strict=True)))) is unit
