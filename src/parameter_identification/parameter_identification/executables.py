"""The executables of the package."""

from tricycle_core.start import start


def identification_monitor() -> None:
    """Run the node of `identification_monitor_node`."""
    start("parameter_identification.identification_monitor_node")
