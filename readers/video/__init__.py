"""Video packets decoded to images."""
