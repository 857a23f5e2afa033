"""Names of the coordinate frames (REP-105)."""

BASE_LINK = "base_link"
"""Frame of the vehicle: origin at its centre of mass, x ahead, y to the left, z up (REP-103)."""

ODOM = "odom"
"""Frame of the ground: fixed, and positions in it do not jump."""

MANEUVER = "maneuver"
"""Frame of a maneuver's path and reference: its origin is the start pose."""


def of_frame(name: str, wanted: str) -> bool:
    """Return whether poses are those of the wanted frame; a missing frame name is accepted.

    Parameters
    ----------
    name : str
        Frame whose pose the message holds: its `child_frame_id`.
    wanted : str
        Frame whose poses are accepted, e.g. `BASE_LINK`.
    """
    return name.lstrip("/") in {"", wanted}
