"""rosbag2 directories (MCAP): written, read and repaired without ROS."""
