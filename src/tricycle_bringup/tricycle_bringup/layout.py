"""The Foxglove layout of a vehicle: the packaged one with its model and an unknown parameter."""

import base64
import json
from importlib.resources import files

from tricycle_bringup.urdf import tricycle_urdf
from tricycle_sim.vehicle import Vehicle


def foxglove_layout(vehicle: Vehicle) -> str:
    """Return the layout, a JSON text; the model is in it because a bag holds none.

    Parameters
    ----------
    vehicle : Vehicle
        Vehicle with the geometry, and the unknown parameter whose standard deviation is shown: its
        first cornering stiffness, or else its first one.
    """
    packaged = files("tricycle_bringup") / "foxglove" / "tricycle.json"
    layout = json.loads(packaged.read_text(encoding="utf-8"))
    model = base64.b64encode(tricycle_urdf(vehicle).encode()).decode()
    panel = layout["configById"]["3D!tricycle"]["layers"]["model"]
    panel["url"] = f"data:application/xml;base64,{model}"
    unknown = sorted(vehicle.unknown, key=lambda name: not name.endswith("cornering_stiffness"))
    if unknown:
        learnt, shown = layout["configById"]["Plot!learnt"], unknown[0]
        for path, value in zip(learnt["paths"], ("std", "planned std"), strict=True):
            path["value"] = f'/identification/estimates.values[:]{{key=="{shown} {value}"}}.value'
        learnt["paths"][0]["label"] = shown.replace(".", " ").replace("_", " ")
        learnt["yAxisLabel"] = vehicle.unit(shown)
    return json.dumps(layout, indent=2, ensure_ascii=False) + "\n"
