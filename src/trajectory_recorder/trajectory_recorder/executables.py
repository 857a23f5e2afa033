"""The executables of the package."""

from tricycle_core.start import start


def trajectory_recorder() -> None:
    """Run the node of `recorder_node`."""
    start("trajectory_recorder.recorder_node")


def bag_replayer() -> None:
    """Run the node of `replayer_node`."""
    start("trajectory_recorder.replayer_node")
