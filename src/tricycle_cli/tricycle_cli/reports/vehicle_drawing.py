"""A vehicle from above, to scale, as an image file."""

import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch, Rectangle
from matplotlib.transforms import Affine2D

from tricycle_core.documents import replacing
from tricycle_core.palette import BLUE, GREY, VERMILLION
from tricycle_sim.vehicle import Vehicle
from tricycle_sim.vehicle.kinematics import curvature, steered_wheels

TYRE_WIDTH = 0.25  # of the radius; no constant says it


def draw_vehicle(vehicle: Vehicle, path: Path) -> None:
    """Draw wheels, centre of mass and the area between the wheels; forward is up.

    Parameters
    ----------
    vehicle : Vehicle
        Vehicle to show.
    path : Path
        Image to be written; its suffix gives the format.
    """
    each = [vehicle.of(wheel) for wheel in vehicle.wheels]
    long = vehicle.wheelbase + 2.0 * max(own.tyre_radius for own in each)
    wide = 2.0 * (max(own.y for own in each) - min(own.y for own in each))
    figure = Figure(figsize=(6.4, min(2.0 + 5.2 * long / wide, 12.0)), layout="constrained")
    axes = figure.add_subplot()
    reach = vehicle.steering_reach
    straight, turned = steered_wheels(vehicle, 0.0), steered_wheels(vehicle, reach)
    loads = vehicle.static_loads()
    _draw_frame(axes, vehicle)
    for wheel, load in zip(vehicle.wheels, loads, strict=True):
        own = vehicle.of(wheel)
        colour = VERMILLION if wheel.driven else BLUE
        if wheel.steered:
            _draw_wheel(axes, own, turned[wheel.name].angle, edgecolor=GREY, fill=False, ls="--")
        angle = straight[wheel.name].angle if wheel.steered else 0.0
        hatch = "///" if wheel.braked else None
        _draw_wheel(axes, own, angle, facecolor=colour, edgecolor="white", hatch=hatch)
        side = 1.0 if own.y > 0.0 else -1.0  # the text stands outside of the wheels
        text = f"{wheel.name.replace('_', ' ')}\n{load:.3g} N"
        place = own.y + 0.8 * side * own.tyre_radius
        left = "right" if side > 0.0 else "left"
        axes.text(place, own.x, text, ha=left, va="center", fontsize="small")
    axes.plot(0.0, 0.0, "o", color="black", markersize=9, markerfacecolor="white")
    axes.plot(0.0, 0.0, "+", color="black", markersize=9)
    radius = 1.0 / abs(curvature(list(turned.values())))
    axes.set_title(
        f"{vehicle.name}: {vehicle.mass:g} kg, wheelbase {vehicle.wheelbase:.3g} m, "
        f"centre of mass {vehicle.com_height:.3g} m high\n"
        f"smallest turn in plans: radius {radius:.3g} m, steering motor at "
        f"{math.degrees(reach):.3g}° (dashed)",
        fontsize="medium",
        parse_math=False,
    )
    handles = [
        Patch(facecolor=VERMILLION, label="driven"),
        Patch(facecolor=BLUE, label="not driven"),
    ]
    if any(wheel.braked for wheel in vehicle.wheels):
        handles.append(Patch(facecolor="white", edgecolor=GREY, hatch="///", label="braked"))
    figure.legend(handles=handles, fontsize="small", loc="outside lower center", ncols=3)
    axes.set(
        xlabel="y / m, left of the centre of mass", ylabel="x / m, ahead of the centre of mass"
    )
    axes.set_aspect("equal", anchor="S")  # next to the legend
    axes.margins(x=0.5, y=0.08)
    axes.invert_xaxis()  # y is to the left
    axes.grid(visible=True, color="0.92")
    axes.set_axisbelow(True)
    title = f"{vehicle.name}, hash {vehicle.fingerprint}"
    with replacing(path) as new:
        figure.savefig(new, bbox_inches="tight", metadata={"Title": title})


def _draw_frame(axes: Axes, vehicle: Vehicle) -> None:
    """The area in which the weight has to stay, and the axles."""
    places = [(vehicle.of(wheel).y, vehicle.of(wheel).x) for wheel in vehicle.wheels]
    corners = sorted(places, key=lambda place: math.atan2(place[1], place[0]))
    axes.fill(*zip(*corners, strict=True), color="0.95", zorder=0)
    for axle in ("front", "rear"):
        ends = [p for p, w in zip(places, vehicle.wheels, strict=True) if w.axle == axle]
        axes.plot(*zip(*ends, strict=True), color="0.6", linewidth=3.0, zorder=1)
    middles = [
        sum(p[0] for p, w in zip(places, vehicle.wheels, strict=True) if w.axle == axle)
        / sum(w.axle == axle for w in vehicle.wheels)
        for axle in ("front", "rear")
    ]
    ends_x = [vehicle.axle_x(axle) for axle in ("front", "rear")]
    axes.plot(middles, ends_x, color="0.6", linewidth=3.0, zorder=1)


def _draw_wheel(axes: Axes, own: SimpleNamespace, angle: float, **style: Any) -> None:
    """A wheel from above; the picture's first axis is y, its second x."""
    x, y, radius = own.x, own.y, own.tyre_radius
    width = TYRE_WIDTH * radius
    shape = Rectangle((y - 0.5 * width, x - radius), width, 2.0 * radius, zorder=2, **style)
    shape.set_transform(Affine2D().rotate_around(y, x, -angle) + axes.transData)
    axes.add_patch(shape)
