"""Recorded messages in the form of ROS 2."""
