"""vision_msgs: boxes in images and in space."""
