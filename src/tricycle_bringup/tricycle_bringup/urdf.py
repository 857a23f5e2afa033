"""The tricycle as a URDF, for RViz and Foxglove to draw; its geometry is the vehicle file's.

`python -m tricycle_bringup.urdf [vehicle.yaml]` prints it. It serves for pictures only: masses, and
the steering's kinematics beyond a fixed ratio, are in the vehicle file alone.
"""

import math
import sys
from collections.abc import Sequence
from pathlib import Path
from xml.etree.ElementTree import Element, SubElement, indent, tostring

from tricycle_core.joints import STEERING_JOINT
from tricycle_sim.vehicle import Vehicle, load_vehicle

TYRE_WIDTH = 0.042  # m
BAR = 0.06  # m, height and width of the frame's bars
RUBBER, PAINT = "0.1 0.1 0.1 1", "0.2 0.4 0.7 1"  # rgba


def tricycle_urdf(vehicle: Vehicle) -> str:
    """Return the URDF, whose root `base_link` is the centre of mass, with the joints that move.

    Both front wheels mimic `steering_motor_joint` with the mean ratio of inner and outer wheel near
    straight ahead, about king-pins tilted back by the caster angle.

    Parameters
    ----------
    vehicle : Vehicle
        With the geometry.
    """
    robot = Element("robot", name=vehicle.name)
    front, rear = vehicle.com_to_front_axle, -vehicle.com_to_rear_axle
    track = vehicle.left_wheel_y - vehicle.right_wheel_y
    middle = 0.5 * (vehicle.left_wheel_y + vehicle.right_wheel_y)
    axle = vehicle.tyre_radius - vehicle.com_height

    base = SubElement(robot, "link", name="base_link")
    _box(base, (front - rear, BAR, BAR), (0.5 * (front + rear), middle, axle))
    _box(base, (BAR, track, BAR), (front, middle, axle))

    SubElement(robot, "link", name="steering_motor")
    motor = _joint(robot, "steering_motor", (front, middle, axle), (0.0, 0.0, 1.0))
    _limit(motor, vehicle)
    tilt = (-math.sin(vehicle.caster_angle), 0.0, math.cos(vehicle.caster_angle))
    for side, y in (("left", vehicle.left_wheel_y), ("right", vehicle.right_wheel_y)):
        _wheel(robot, f"{side}_wheel", vehicle)
        joint = _joint(robot, f"{side}_wheel", (front, y, axle), tilt)
        _limit(joint, vehicle)
        ratio = 0.5 * (1.0 + vehicle.steering_ratio_straight)
        SubElement(joint, "mimic", joint=STEERING_JOINT, multiplier=_text(ratio))
    _wheel(robot, "rear_wheel", vehicle)
    _joint(
        robot, "rear_wheel", (rear, vehicle.rear_wheel_y, axle), (0.0, 1.0, 0.0), kind="continuous"
    )
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
    SubElement(joint, "parent", link="base_link")
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


def _wheel(robot: Element, name: str, vehicle: Vehicle) -> None:
    link = SubElement(robot, "link", name=name)
    geometry = _visual(link, (0.0, 0.0, 0.0), 0.5 * math.pi, RUBBER)  # a cylinder lies along z
    SubElement(geometry, "cylinder", radius=_text(vehicle.tyre_radius), length=_text(TYRE_WIDTH))


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
