"""The Foxglove layout of a vehicle: the packaged one with the vehicle's model in it."""

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
        With the geometry.
    """
    packaged = files("tricycle_bringup") / "foxglove" / "tricycle.json"
    layout = json.loads(packaged.read_text(encoding="utf-8"))
    model = base64.b64encode(tricycle_urdf(vehicle).encode()).decode()
    panel = layout["configById"]["3D!tricycle"]["layers"]["model"]
    panel["url"] = f"data:application/xml;base64,{model}"
    return json.dumps(layout, indent=2, ensure_ascii=False) + "\n"
