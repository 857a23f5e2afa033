"""Commands of the vehicle: whose count, from ROS messages, and for the boards."""
