"""Area files: what they hold, and one line for what is wrong with them."""

import math
from pathlib import Path

import numpy as np
import pytest
import shapely

from excitation_planner.area.area import Area, StartRegion, load_area
from tricycle_core.errors import PlanError

YARD = "keep_in: [[0, 0], [12, 0], [12, 25], [0, 25]]\n"


def test_a_whole_file(tmp_path: Path) -> None:
    file = tmp_path / "yard.yaml"
    file.write_text(
        YARD + "about: behind hall 3\n"
        "keep_out: [[[1, 10], [2, 10], [2, 11]], [[9, 1], [9, 2], [8, 1]]]\n"
        "margin: 1\nframe: map\ndatum: [48.2, 11.6]\n"
        "start: {x: 6, y: [3, 20], heading: [-0.1, 0.1]}\n"
    )
    area = load_area(file)
    np.testing.assert_array_equal(area.keep_in, [[0, 0], [12, 0], [12, 25], [0, 25]])
    assert [len(corners) for corners in area.keep_out] == [3, 3]
    assert (area.margin, area.frame, area.datum) == (1.0, "map", (48.2, 11.6))
    assert (area.start.x, area.start.y, area.start.heading) == ((6, 6), (3, 20), (-0.1, 0.1))


def test_headings_may_go_across_a_whole_turn(tmp_path: Path) -> None:
    file = tmp_path / "yard.yaml"
    file.write_text(YARD + "start: {heading: [6.0, 6.5]}\n")
    assert load_area(file).start.heading == (6.0, 6.5)


def test_what_may_be_left_out(tmp_path: Path) -> None:
    file = tmp_path / "yard.yaml"
    file.write_text(YARD)
    area = load_area(file)
    assert area.keep_out == ()
    assert area.start.heading == (-math.pi, math.pi)
    assert area.start.x == (-math.inf, math.inf)


@pytest.mark.parametrize(
    "start", ["{x: [-5, 1]}", "{x: [-.inf, 1]}", "{x: 1, y: [-5, 1]}", "{x: [0, 12], y: [2, 4]}"]
)
def test_a_start_may_be_in_part_outside(tmp_path: Path, start: str) -> None:
    file = tmp_path / "yard.yaml"
    file.write_text(f"{YARD}keep_out: [[[2, 2], [8, 2], [8, 8], [2, 8]]]\nstart: {start}\n")
    assert load_area(file).start != StartRegion()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "needs keep_in"),
        ("keep_in: [[0, 0], [1, 0]]", "keep_in: needs three corners or more"),
        ("keep_in: [[0, 0], [1, 0], [a, 1]]", "keep_in: needs a list of numbers"),
        ("keep_in: [[0, 0], [4, 4], [4, 0], [0, 4]]", "keep_in: crosses or touches itself"),
        (
            "keep_in: [[0, 0], [1, 0], [.inf, 1]]",
            "keep_in[2]: [inf, 1] must be metres within 100 km",
        ),
        ("keep_in: [[0, 0], [1, 0], [500000, 1]]", "keep_in[2]: [500000, 1] must be metres"),
        ("keep_in: [[true, 0], [1, 0], [1, 1]]", "needs a list of numbers"),
        ("keep_in: [['0', 0], [1, 0], [1, 1]]", "needs a list of numbers"),
        (YARD + "keep_out: [[[0, 0], [1, 1]]]", "keep_out[0]: needs three corners"),
        (YARD + "margin: -1", "margin: needs a number of at least 0 m, not -1"),
        (
            '{"type": "FeatureCollection", "features": []}',
            "is GeoJSON, in degrees; an area is in metres, in the frame of the poses: keep_in: ",
        ),
        (YARD + "margins: 1", "margins: is not a key; did you mean margin?"),
        (YARD + "start: {theta: 1}", "start.theta: is not a key; there are: x, y, heading"),
        (
            YARD + "start: {heading: [0, 90]}",
            "start.heading: [0, 90] is not part of a turn, in rad",
        ),
        (YARD + "start: {heading: [45, 50]}", "start.heading: [45, 50] is not part of a turn"),
        (YARD + "start: {heading: [-90, -85]}", "start.heading: [-90, -85] is not part of a turn"),
        (YARD + "start: {heading: 90}", "start.heading: [90, 90] is not part of a turn, in rad"),
        (YARD + "start: {x: [3, 2]}", "start.x: needs [low, high], not [3, 2]"),
        (YARD + "start: {x: 13, y: 1}", "start: x 13, y 1 is outside of keep_in"),
        (YARD + "start: {x: [40, 45]}", "start: all of x 40 to 45 is outside of keep_in"),
        (YARD + "start: {x: [-9, -5]}", "start: all of x -9 to -5 is outside of keep_in"),
        (YARD + "start: {x: 6, y: [26, 30]}", "start: all of x 6, y 26 to 30 is outside of"),
        (
            YARD + "keep_out: [[[2, 2], [8, 2], [8, 8], [2, 8]]]\nstart: {x: [2, 8], y: [3, 7]}",
            "start: all of x 2 to 8, y 3 to 7 is outside of keep_in or in a keep_out",
        ),
        (YARD + "datum: [200, 11]", "datum: needs [latitude, longitude] in degrees"),
        (YARD + "frame: ''", "frame: needs the name of a frame"),
        (YARD + "frame: [odom]", "frame: needs a text, not a list"),
        ("keep_in: &a [[0, 0]]\nkeep_out: [*a]", "is not valid YAML: aliases are not read"),
        ("keep_in: [", "is not valid YAML"),
    ],
)
def test_what_is_wrong_is_one_line(tmp_path: Path, text: str, message: str) -> None:
    file = tmp_path / "yard.yaml"
    file.write_text(text)
    with pytest.raises(PlanError) as caught:
        load_area(file)
    assert str(caught.value).startswith(str(file))
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_clearance_counts_outline_and_obstacles() -> None:
    square = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 10.0], [0.0, 10.0]])
    area = Area(square, (np.array([[4.0, 4.0], [6.0, 4.0], [6.0, 6.0], [4.0, 6.0]]),))
    points = np.array([[1.0, 5.0], [3.5, 5.0], [5.0, 5.0], [-2.0, 5.0]])
    np.testing.assert_allclose(area.clearance(points), [1.0, 0.5, -1.0, -2.0])


@pytest.mark.parametrize("margin", [0.5, 1.0])
def test_the_ground_keeps_its_margin_around_corners(margin: float) -> None:
    post = np.array([[4.0, 4.0], [6.0, 4.0], [6.0, 6.0], [4.0, 6.0]])
    yard = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 10.0], [0.0, 10.0]])
    hole = min(map(shapely.Polygon, Area(yard, (post,)).within(margin)), key=lambda p: p.area)
    assert shapely.distance(hole.exterior, shapely.Polygon(post)) > 0.998 * margin
