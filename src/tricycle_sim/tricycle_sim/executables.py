"""The executable of the package."""

from tricycle_core.start import start


def tricycle_sim() -> None:
    """Run the node of `sim_node`."""
    start("tricycle_sim.sim_node")
