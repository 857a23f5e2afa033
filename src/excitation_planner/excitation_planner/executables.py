"""The executables of the package."""

from tricycle_core.start import start


def excitation_planner() -> None:
    """Run the node of `planner_node`."""
    start("excitation_planner.planner_node")


def maneuver_driver() -> None:
    """Run the node of `maneuver_driver_node`."""
    start("excitation_planner.maneuver_driver_node")
