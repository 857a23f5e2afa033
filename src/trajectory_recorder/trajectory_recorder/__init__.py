"""RECORD: MCAP bags: recorder, replayer and a reader without ROS."""
