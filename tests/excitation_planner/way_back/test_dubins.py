"""Dubins paths lead to their goal, and no way of bounded curvature is shorter."""

import math

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from excitation_planner.way_back.dubins import WORDS, Arc, dubins_arcs, dubins_lengths

RADIUS = 2.0
POSES = st.tuples(*(st.floats(-8.0, 8.0),) * 2, st.floats(-math.pi, math.pi))
BENDS = st.tuples(st.sampled_from([-1.0, 0.0, 1.0]), st.floats(0.0, 6.0))


def lengths(start, goal):
    return dubins_lengths(np.array([start]), np.array([goal]), RADIUS)[:, :, 0, 0]


def assert_at(pose, other):
    assert math.hypot(pose[0] - other[0], pose[1] - other[1]) < 1e-6
    assert abs(math.remainder(pose[2] - other[2], math.tau)) < 1e-6


@given(start=POSES, goal=POSES)
def test_every_word_leads_to_the_goal(start, goal):
    found = lengths(start, goal)
    assert np.isfinite(found).all(axis=1).any()
    for word, parts in zip(WORDS, found, strict=True):
        if np.isfinite(parts).all():
            arcs = dubins_arcs(start, word, parts, RADIUS)
            assert_at(arcs[-1].end if arcs else start, goal)


# one arc in two parts, whose straight line between is 4e-8 m long by round-off
@example(start=(0.28, 0.0, -2.4979059533510974), bends=[(-1.0, 1.4439042038885725)] * 2)
@given(start=POSES, bends=st.lists(BENDS, min_size=1, max_size=5))
def test_no_other_way_of_arcs_and_lines_is_shorter(start, bends):
    pose = start
    for side, length in bends:
        pose = Arc(pose, side / RADIUS, length).end
    shortest = lengths(start, pose).sum(axis=1).min()
    assert shortest <= sum(length for _, length in bends) + 1e-6


@given(start=POSES, goal=POSES)
def test_the_way_back_on_the_same_arcs_ends_where_it_began(start, goal):
    found = lengths(start, goal)
    word = int(np.argmin(found.sum(axis=1)))
    arcs = dubins_arcs(start, WORDS[word], found[word], RADIUS)
    back = dubins_arcs(goal, WORDS[word][::-1], -found[word, ::-1], RADIUS)
    assert_at(back[-1].end if back else goal, start)
    assert sum(abs(arc.length) for arc in back) == pytest.approx(sum(arc.length for arc in arcs))
