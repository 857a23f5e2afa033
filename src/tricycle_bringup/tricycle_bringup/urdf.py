"""A vehicle as a URDF, for RViz and Foxglove to draw; its geometry is the vehicle file's.

`python -m tricycle_bringup.urdf [vehicle.yaml]` prints it. It serves for pictures only: masses, and
the steering's kinematics beyond a fixed ratio, are in the vehicle file alone.
"""

import math
import sys
from collections.abc import Sequence
from pathlib import Path
from xml.etree.ElementTree import Element, SubElement, indent, tostring

from tricycle_core.frames import BASE_LINK
from tricycle_core.joints import REAR_WHEEL_JOINT, STEERING_JOINT
from tricycle_sim.vehicle import Vehicle, load_vehicle
from tricycle_sim.vehicle.kinematics import king_pin_angles

TYRE_WIDTH = 0.042  # m; of a small wheel half its radius
BAR = 0.06  # m, height and width of the frame's bars; of a small vehicle 5 % of the wheelbase
RUBBER, PAINT = "0.1 0.1 0.1 1", "0.2 0.4 0.7 1"  # rgba


def tricycle_urdf(vehicle: Vehicle) -> str:
    """Return the URDF, whose root `base_link` is the centre of mass, with the joints that move.

    Steered wheels mimic `steering_motor_joint` with the ratio that they have near straight ahead,
    about king-pins tilted back by the caster angle. The others roll with `rear_wheel_joint`, that
    of the driven wheels.

    Parameters
    ----------
    vehicle : Vehicle
        Vehicle with the geometry.
    """
    robot = Element("robot", name=vehicle.name)
    places = {
        wheel.name: (own.x, own.y, own.tyre_radius - own.com_height)
        for wheel in vehicle.wheels
        for own in [vehicle.of(wheel)]
    }
    by_axle = {
        axle: [places[wheel.name] for wheel in vehicle.wheels if wheel.axle == axle]
        for axle in ("front", "rear")
    }
    front, rear = vehicle.axle_x("front"), vehicle.axle_x("rear")
    pairs = [axle for axle in by_axle.values() if len(axle) == 2]
    middle = 0.5 * (pairs[0][0][1] + pairs[0][1][1])
    height = by_axle["front"][0][2]

    base = SubElement(robot, "link", name=BASE_LINK)
    bar = min(BAR, 0.05 * vehicle.wheelbase)
    _box(base, (front - rear, bar, bar), (0.5 * (front + rear), middle, height))
    for (x, y, z), (_, other_y, _) in pairs:
        _box(base, (bar, abs(y - other_y), bar), (x, 0.5 * (y + other_y), z))

    SubElement(robot, "link", name="steering_motor")
    steered_x = vehicle.axle_x(next(wheel.axle for wheel in vehicle.wheels if wheel.steered))
    motor = _joint(robot, "steering_motor", (steered_x, middle, height), (0.0, 0.0, 1.0))
    _limit(motor, vehicle)
    tilt = (-math.sin(vehicle.caster_angle), 0.0, math.cos(vehicle.caster_angle))
    for name, (angle, slope) in king_pin_angles(vehicle).items():
        # rear_wheel_joint is the driven wheels'
        link = "steered_wheel" if name == "rear" else f"{name}_wheel"
        _wheel(robot, link, vehicle.of(name).tyre_radius)
        joint = _joint(robot, link, places[name], tilt)
        _limit(joint, vehicle)
        mimic = SubElement(joint, "mimic", joint=STEERING_JOINT, multiplier=_text(slope))
        if angle:
            mimic.set("offset", _text(angle))
    rolling = [wheel.name for wheel in vehicle.wheels if not wheel.steered]
    if "rear" not in rolling:
        SubElement(robot, "link", name="rear_wheel")
        origin = (rear, middle, height)
        _joint(robot, "rear_wheel", origin, (0.0, 1.0, 0.0), kind="continuous")
    for name in rolling:
        _wheel(robot, f"{name}_wheel", vehicle.of(name).tyre_radius)
        axis = (0.0, 1.0, 0.0)
        joint = _joint(robot, f"{name}_wheel", places[name], axis, kind="continuous")
        if name != "rear":
            SubElement(joint, "mimic", joint=REAR_WHEEL_JOINT)
    indent(robot)
    return '<?xml version="1.0"?>\n' + tostring(robot, encoding="unicode") + "\n"


def _text(*numbers: float) -> str:
    return " ".join(f"{number:.6g}" for number in numbers)


def _joint(
    robot: Element,
    child: str,
    origin: tuple[float, ...],
    axis: tuple[float, ...],
    *,
    kind: str = "revolute",
) -> Element:
    """Joint `<child>_joint` of `base_link`."""
    joint = SubElement(robot, "joint", name=f"{child}_joint", type=kind)
    SubElement(joint, "parent", link=BASE_LINK)
    SubElement(joint, "child", link=child)
    SubElement(joint, "origin", xyz=_text(*origin), rpy="0 0 0")
    SubElement(joint, "axis", xyz=_text(*axis))
    return joint


def _limit(joint: Element, vehicle: Vehicle) -> None:
    lock, slew = vehicle.steering_limit, vehicle.steering_slew
    values = {"lower": -lock, "upper": lock, "velocity": slew, "effort": 0.0}
    SubElement(joint, "limit", {name: _text(value) for name, value in values.items()})


def _visual(link: Element, origin: tuple[float, ...], roll: float, colour: str) -> Element:
    visual = SubElement(link, "visual")
    SubElement(visual, "origin", xyz=_text(*origin), rpy=_text(roll, 0.0, 0.0))
    geometry = SubElement(visual, "geometry")
    material = SubElement(visual, "material", name="rubber" if colour is RUBBER else "paint")
    SubElement(material, "color", rgba=colour)
    return geometry


def _box(link: Element, size: tuple[float, ...], origin: tuple[float, ...]) -> None:
    SubElement(_visual(link, origin, 0.0, PAINT), "box", size=_text(*size))


def _wheel(robot: Element, name: str, radius: float) -> None:
    link = SubElement(robot, "link", name=name)
    geometry = _visual(link, (0.0, 0.0, 0.0), 0.5 * math.pi, RUBBER)  # a cylinder lies along z
    width = min(TYRE_WIDTH, 0.5 * radius)
    SubElement(geometry, "cylinder", radius=_text(radius), length=_text(width))


def main(arguments: Sequence[str]) -> None:
    """Print a URDF.

    Parameters
    ----------
    arguments : sequence of str
        The vehicle file; without one, the packaged tricycle is printed.
    """
    print(tricycle_urdf(load_vehicle(Path(arguments[0]) if arguments else None)), end="")


if __name__ == "__main__":
    main(sys.argv[1:])
