"""Names of the two joints that are commanded and measured (docs/reference-nodes.md)."""

STEERING_JOINT = "steering_motor_joint"
"""Steering motor: position in rad, left positive."""

REAR_WHEEL_JOINT = "rear_wheel_joint"
"""Driven wheel: velocity in rad/s, forward positive; times the tyre radius it is the speed."""

SPIN_JOINT = "_wheel_spin_joint"
"""How the name of the joint about which a wheel rolls ends, after the wheel's own in the file.

`<wheel>_wheel_joint` is the king-pin where the wheel is steered.
"""

JOINTS = (STEERING_JOINT, REAR_WHEEL_JOINT)
"""Both, in the order of every command."""
