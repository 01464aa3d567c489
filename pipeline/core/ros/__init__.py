"""ROS messages: definitions, builders, quality of service."""
