"""lidcam: recorded lidar and camera topics in, fused objects out."""
