"""Recorded lidar and camera topics in, fused objects out."""
