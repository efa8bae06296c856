"""Logs out: MCAP, ROS 1 bag, rosbag2, CSV."""
