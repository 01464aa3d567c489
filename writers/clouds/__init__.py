"""Clouds of tracked objects, one file each."""
