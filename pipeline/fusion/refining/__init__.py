"""Boxes fitted to what the images show."""
