"""A vehicle file is complete, in its units and plausible, or one line says what is not."""

import math
from importlib import resources

import pytest
import yaml

from tricycle_core.errors import VehicleError
from tricycle_sim.vehicle import UNKNOWN_PARAMETERS, load_vehicle, warnings_about

TEXT = (resources.files("tricycle_sim") / "tricycle.yaml").read_text(encoding="utf-8")


def write(path, change):
    """Write the packaged file with a change and return its path."""
    document = yaml.safe_load(TEXT)
    change(document)
    path.write_text(yaml.safe_dump(document), encoding="utf-8")
    return path


def test_packaged_vehicle_is_table_2_of_the_paper():
    vehicle = load_vehicle()
    assert vehicle.mass == 48.3
    assert vehicle.com_to_front_axle + vehicle.com_to_rear_axle == pytest.approx(1.443)
    assert vehicle.caster_angle == pytest.approx(math.radians(20.0))
    assert [*vehicle.unknown] == [name for name in UNKNOWN_PARAMETERS if name in vehicle.unknown]
    assert len(vehicle.unknown) == 6
    assert vehicle.unknown["cornering_stiffness"] == (500.0, 1500.0)
    assert vehicle.nominal_point() == pytest.approx([1000.0, 50.0, 0.15, 50.0, 0.009, 5e-4])


def test_a_file_may_leave_less_unknown(tmp_path):
    def know_the_inertia(document):
        document["constants"]["yaw_inertia"] = {
            "value": 30.0,
            "unit": "kg m^2",
            "basis": "data",
            "about": "measured on a pendulum",
        }

    vehicle = load_vehicle(write(tmp_path / "v.yaml", know_the_inertia))
    assert "yaw_inertia" not in vehicle.unknown
    assert vehicle.yaw_inertia == 30.0
    assert vehicle.nominal_point().shape == (5,)
    assert warnings_about(vehicle) == ()


def constant(name, **entries):
    return lambda document: document["constants"][name].update(entries)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: d["constants"].pop("mass"), "mass: is missing (kg)"),
        (lambda d: d["constants"].update(wings=1), "wings: is not a constant"),
        (lambda d: d.update(colour="red"), "colour: is not a key"),
        (lambda d: d.pop("name"), "name: needs a text"),
        (lambda d: d.update(name="a\x1b[31m\nb"), "name: needs a text of one line"),
        (lambda d: d.pop("constants"), "needs the keys"),
        (constant("mass", unit="g"), "mass.unit: needs 'kg', not 'g'"),
        (constant("mass", value="heavy"), "mass.value: needs a number, not 'heavy'"),
        (constant("mass", value=True), "mass.value: needs a number"),
        (constant("mass", basis="guess"), "mass.basis: needs one of data"),
        (constant("mass", about=None), "mass.about: needs a text"),
        (constant("mass", colour="red"), "mass.colour: is not a key"),
        (constant("mass", vale=1), "mass.vale: is not a key of a constant; did you mean value?"),
        (lambda d: d["constants"]["mass"].update({3: None}), "numbers need a decimal point"),
        (constant("mass", value="5e1"), "not '5e1' (YAML wants 5.0e-4 for 5e-4"),
        (constant("mass", value=None), "mass.value: is missing"),
        (constant("mass", value=10**400), "mass.value: is too large a number"),
        (lambda d: d.update(constant={}), "constant: is not a key of a vehicle file; did you mean"),
        (
            lambda d: d["constants"].update({"front.mass": {}}),
            "front.mass: is not a constant of this vehicle; did you mean mass?",
        ),
        (constant("caster_angle", value=90), "is not in [-0.7, 0.7] (-40.1 to 40.1 deg)"),
        (constant("mass", range=[1, 2], nominal=1), "mass: needs either value"),
        (constant("cornering_stiffness", range=[1500, 500]), "upside down"),
        (constant("cornering_stiffness", nominal=1), "cornering_stiffness.nominal: 1 is outside"),
        (constant("cornering_stiffness", range=[500]), "nominal and range"),
        (constant("right_wheel_y", value=0.3), "right_wheel_y: 0.3 m is not in"),
    ],
)
def test_a_wrong_file_gets_one_line_with_the_place(tmp_path, change, message):
    path = write(tmp_path / "v.yaml", change)
    with pytest.raises(VehicleError, match=r"^[^\n]*$") as error:
        load_vehicle(path)
    assert str(error.value).startswith(f"{path}: ")
    assert message in str(error.value)


def unknown(name, nominal, low, high):
    def spread(document):
        entry = document["constants"][name]
        del entry["value"]
        entry.update(nominal=nominal, range=[low, high])

    return spread


def test_any_constant_of_the_motion_can_be_unknown(tmp_path):
    vehicle = load_vehicle(write(tmp_path / "v.yaml", unknown("mass", 48.3, 40.0, 50.0)))
    assert vehicle.unknown["mass"] == (40.0, 50.0)
    assert [*vehicle.unknown] == [*load_vehicle().unknown, "mass"]  # the paper's come first


CART = """
name: cart
wheels:
  - {name: front_left, axle: front, steered: true}
  - {name: front_right, axle: front, steered: true}
  - {name: rear_left, axle: rear, driven: true, braked: true}
  - {name: rear_right, axle: rear, driven: true, braked: true}
parts: {steering: ackermann, front.tyre: magic_formula}
constants: {}
"""
NUMBERS = {
    "front.x": 0.9, "rear.x": -0.7, "front_left.y": 0.4, "front_right.y": -0.4, "rear_left.y": 0.4,
    "rear_right.y": -0.4, "wheel_inertia": 0.2, "rear.cornering_stiffness": 1500.0,
    "front.shape_longitudinal": 1.6, "front.curvature_longitudinal": 0.3,
    "front.shape_lateral": 1.3, "front.curvature_lateral": -0.8,
}  # fmt: skip
TADPOLES = ("com_to_", "wheel_y", "front_wheel", "rear_wheel", "steering_ratio")


def cart(path, change=lambda document: None):
    """Write a file of a cart with four wheels, with a change, and return its path."""
    document = yaml.safe_load(CART)
    entries = yaml.safe_load(TEXT)["constants"]
    entries = {n: e for n, e in entries.items() if not any(part in n for part in TADPOLES)}
    wheel_names = {"x": "m", "y": "m", "inertia": "kg m^2", "stiffness": "N/rad"}
    for name, value in NUMBERS.items():
        unit = next((u for end, u in wheel_names.items() if name.endswith(end)), "1")
        entries[name] = {"value": value, "unit": unit, "basis": "argued", "about": "made up"}
    document["constants"] = entries
    change(document)
    path.write_text(yaml.safe_dump(document, sort_keys=False), encoding="utf-8")
    return path


def again(name, *others):
    """A change that says a constant under other names too."""

    def change(document):
        constants = document["constants"]
        constants.update({other: dict(constants[name]) for other in others})

    return change


def turned(linkage, name, value, limits=None):
    """A change to a linkage, with a value or a range of one of its constants."""
    number = {"value": value} if limits is None else {"nominal": value, "range": limits}

    def change(document):
        document["parts"]["steering"] = linkage
        document["constants"][name] = {
            **number,
            "unit": "1",
            "basis": "argued",
            "about": "made up",
        }

    return change


def test_a_file_may_list_its_wheels_and_laws(tmp_path):
    vehicle = load_vehicle(cart(tmp_path / "cart.yaml"))
    assert [wheel.name for wheel in vehicle.wheels][2:] == ["rear_left", "rear_right"]
    assert vehicle.wheelbase == pytest.approx(1.6)
    assert vehicle.of("rear_left").cornering_stiffness == 1500.0
    assert vehicle.of("front_left").cornering_stiffness == vehicle.cornering_stiffness
    front, _, rear, _ = vehicle.static_loads()
    assert front / rear == pytest.approx(0.7 / 0.9)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: d.update(wheels=d["wheels"][:2]), "wheels: needs three or four, not 2"),
        (lambda d: d["wheels"][0].update(axle="middle"), "front_left.axle: needs front or rear"),
        (
            lambda d: d["wheels"][0].update(stered=True),
            "is not a key of a wheel; did you mean steered",
        ),
        (lambda d: d["wheels"][0].update(steered="yes"), "front_left.steered: needs true or false"),
        (lambda d: d["wheels"][0].update(steered=False), "have to be all of one axle"),
        (lambda d: d["parts"].update(steering="akermann"), "parts.steering: 'akermann' must be"),
        (lambda d: d["parts"].update(drive="single"), "single does not fit the driven wheels"),
        (lambda d: d["constants"].pop("wheel_inertia"), "wheel_inertia: is missing (kg m^2)"),
        (lambda d: d["constants"].pop("rear_left.y"), "rear_left.y: is missing (m)"),
        (
            lambda d: d["constants"].update({"rear.shape_lateral": {}}),
            "rear.shape_lateral: is not a constant of this vehicle; the tyre magic_formula",
        ),
        (lambda d: d["constants"].update({"frnt.x": {}}), "did you mean front.x"),
        (
            again("tyre_radius", "front.tyre_radius", "rear.tyre_radius"),
            "tyre_radius: no wheel reads it, but front.tyre_radius and rear.tyre_radius instead",
        ),
        (
            again("front.x", "com_to_front_axle"),
            "com_to_front_axle: no wheel reads it, but front.x instead",
        ),
        (turned("ackermann", "steering_scale", 2.0), "-+45 deg, a wheel turns from 104 to -76 deg"),
        (
            turned("parallel", "steering_gain", 5.0),
            "a wheel turns from -225 to 225 deg: needs a rising angle below 90 deg",
        ),
        (
            turned("parallel", "steering_gain", 1.0, [0.5, 2.5]),
            "turns with steering_gain = 2.5 from -113 to 113 deg",
        ),
    ],
)
def test_a_wrong_structure_gets_one_line_with_the_place(tmp_path, change, message):
    path = cart(tmp_path / "cart.yaml", change)
    with pytest.raises(VehicleError, match=r"^[^\n]*$") as error:
        load_vehicle(path)
    assert message in str(error.value)


def test_a_setting_of_the_boards_cannot_be_unknown(tmp_path):
    path = write(tmp_path / "v.yaml", unknown("steering_slew", 2.0, 1.0, 3.0))
    with pytest.raises(
        VehicleError, match="steering_slew: cannot be unknown: it is a setting of the boards"
    ):
        load_vehicle(path)


def test_a_key_that_stands_twice_is_refused_with_its_line(tmp_path):
    path = tmp_path / "v.yaml"
    lines = TEXT.splitlines()
    (number,) = (at for at, line in enumerate(lines) if line.startswith("  mass:"))
    lines.insert(number, lines[number])
    path.write_text("\n".join(lines), encoding="utf-8")
    with pytest.raises(VehicleError, match=rf"^{path}:{number + 2}: mass: is there twice$"):
        load_vehicle(path)


def test_not_yaml_at_all(tmp_path):
    path = tmp_path / "v.yaml"
    path.write_text("name: [", encoding="utf-8")
    with pytest.raises(VehicleError, match="is not valid YAML"):
        load_vehicle(path)


def test_laws_of_parts_are_named_and_change_the_fingerprint(tmp_path):
    path = write(tmp_path / "v.yaml", lambda d: d.update(parts={"tyre": "linear"}))
    vehicle = load_vehicle(path)
    assert vehicle.parts == {"tyre": "linear"}
    assert vehicle.fingerprint != load_vehicle().fingerprint
    with pytest.raises(VehicleError, match="parts: needs names of laws by part"):
        load_vehicle(write(tmp_path / "v.yaml", lambda d: d.update(parts={"tyre": 1})))
