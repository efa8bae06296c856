"""Logs out: MCAP, ROS 1 bag, rosbag2, CSV; export.py cuts a stretch out of a log."""
