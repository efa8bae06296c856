"""Bytes of a message to columns of numbers: CDR, ROS 1, protobuf, JSON, NMEA sentences."""
