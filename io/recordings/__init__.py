"""Readers of recordings of messages: MCAP, ROS 1 bags, rosbag2."""
