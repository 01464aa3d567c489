"""What is known of ROS messages: definitions, builders, quality of service, the layout of their bytes."""
