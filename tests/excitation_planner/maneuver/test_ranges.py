"""The search box: ranges that a user gives in place of the families' own."""

import pytest

from excitation_planner.maneuver import (
    Circle,
    family_by_name,
    family_names,
    load_ranges,
    operation_point,
    parse_ranges,
    shown_ranges,
    with_ranges,
)
from tricycle_core.errors import InfeasibleManeuver, PlanError
from tricycle_sim.vehicle import load_vehicle

FAMILIES = (Circle(), family_by_name("step_steer"))


def test_a_range_replaces_that_of_every_family_or_of_one():
    circle, step = with_ranges(FAMILIES, parse_ranges(["speed=1:1.5", "circle.radius=3:12"]))
    assert circle.operation.bounds() == {"radius": (3.0, 12.0), "speed": (1.0, 1.5)}
    assert step.operation.bounds()["speed"] == (1.0, 1.5)
    assert step.operation.bounds()["angle"] == FAMILIES[1].operation.bounds()["angle"]
    (circle, _) = with_ranges(FAMILIES, {"speed": (1.0, 1.5), "circle.speed": (0.5, 0.7)})
    assert circle.operation.bounds()["speed"] == (0.5, 0.7)


def test_on_an_area_what_makes_a_maneuver_smaller_is_searched_too():
    slalom, circle = with_ranges([family_by_name("slalom"), Circle()], {}, smaller=True)
    bounds = slalom.operation.bounds()
    assert bounds["speed"] == (1.0, 2.0)
    assert bounds["gates"] == (3.0, 6.0)
    assert "lead_out" not in bounds
    assert circle.operation == Circle().operation  # whose speed is searched anyway
    (sweep,) = with_ranges([family_by_name("sine_sweep")], {}, smaller=True)
    assert sweep.operation.bounds()["turn"] == (0.0, 0.6)
    assert sweep.operation.bounds()["duration"] == (6.0, 15.0)
    (given,) = with_ranges([family_by_name("slalom")], {"gates": (4.0, 5.0)}, smaller=True)
    assert given.operation.bounds()["gates"] == (4.0, 5.0)


def test_a_wider_box_gives_the_maneuvers_of_its_family():
    (circle,) = with_ranges([Circle()], {"radius": (3.0, 12.0)})
    x = operation_point(circle, {"radius": 11.0, "speed": 0.8})
    vehicle = load_vehicle()
    assert circle.name == "circle"
    assert circle.drive(x, vehicle).length == Circle().drive(x, vehicle).length


def test_a_setting_of_a_family_is_searched_too_where_it_gets_a_range():
    slalom = family_by_name("slalom")
    (freed,) = with_ranges([slalom], {"slalom.speed": (1.0, 2.5)})
    assert freed.operation.bounds() == slalom.operation.bounds() | {"speed": (1.0, 2.5)}
    vehicle = load_vehicle()
    slow, usual = (
        freed.drive(operation_point(freed, {"spacing": 4.0, "offset": 0.5, "speed": v}), vehicle)
        for v in (1.2, slalom.speed)
    )
    assert slow.speed == 1.2
    own = slalom.drive(operation_point(slalom, {"spacing": 4.0, "offset": 0.5}), vehicle)
    assert (usual.speed, usual.length) == (own.speed, own.length)


@pytest.mark.parametrize("name", family_names())
def test_what_is_shown_is_read_again(name):
    bounds = family_by_name(name).operation.bounds()
    assert parse_ranges(shown_ranges(bounds).split()) == bounds


def test_yaml_gives_the_same_ranges(tmp_path):
    file = tmp_path / "yard.yaml"
    file.write_text("radius: [3, 12]\ncircle: {speed: [0.5, 1.5]}\n")
    assert load_ranges(file) == {"radius": (3.0, 12.0), "circle.speed": (0.5, 1.5)}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("radius", "needs entries like radius"),
        ("radius: 3", r"radius: needs \[low, high\], not 3"),
        ("circle: {speed: [1, fast]}", "circle.speed: "),
        ("a: [1\nb: 2", "is not valid YAML"),
    ],
)
def test_wrong_yaml_is_told_with_its_place(tmp_path, text, message):
    (tmp_path / "yard.yaml").write_text(text)
    with pytest.raises(PlanError, match=message):
        load_ranges(tmp_path / "yard.yaml")


@pytest.mark.parametrize(
    ("texts", "message"),
    [
        (["radius=3"], "needs NAME=LOW:HIGH"),
        (["radius=3:4:5"], "needs NAME=LOW:HIGH"),
        (["radius=3:4", "radius=3:5"], "radius is given twice"),
        (["radius=4:3"], r"circle: radius: range \(4, 3\) must be finite with low < high"),
        (["width=1:2"], "range of 'width': the parameters are radius, circle.radius, speed"),
    ],
)
def test_wrong_ranges_are_told(texts, message):
    with pytest.raises(PlanError, match=message):
        with_ranges(FAMILIES, parse_ranges(texts))


def test_what_a_family_cannot_give_in_a_wide_box_is_not_driven():
    from excitation_planner.planning.replay import nominal_run

    (family,) = with_ranges([family_by_name("double_lane_change")], {"d1": (0.0, 40.0)})
    with pytest.raises(InfeasibleManeuver, match="the path runs backwards"):
        nominal_run(load_vehicle(), family, family.operation.from_unit([1.0, 0.0]))
