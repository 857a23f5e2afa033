"""Frames of positions and motions (REP-105)."""

BASE_LINK = "base_link"
"""Of the vehicle: at its centre of mass, x ahead, y to the left, z up (REP-103)."""

ODOM = "odom"
"""Of the ground: fixed, and positions in it do not jump."""

MANEUVER = "maneuver"
"""Of a maneuver's path and reference: its origin is the pose of the start."""


def of_frame(name: str, wanted: str) -> bool:
    """Return whether poses of a frame are those of the wanted one; if they name none, they are.

    Parameters
    ----------
    name : str
        `child_frame_id` of a message.
    wanted : str
        Whose poses are taken.
    """
    return name.lstrip("/") in {"", wanted}
