"""The executable of the package."""

from tricycle_core.start import start


def tricycle_bridge() -> None:
    """Run the node of `bridge_node`."""
    start("tricycle_bridge.bridge_node")
