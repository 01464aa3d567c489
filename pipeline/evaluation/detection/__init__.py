"""Detections against truth: what was found, missed and invented, and how well it was placed."""
