"""2D boxes of the cameras against what their images show."""
