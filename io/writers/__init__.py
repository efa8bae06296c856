"""Logs out: MCAP, ROS 1 bag, rosbag2, CSV; export.py cuts a time span out of a log."""
