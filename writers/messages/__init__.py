"""Results as ROS and Foxglove messages."""
