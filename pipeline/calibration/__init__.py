"""Calibration errors estimated from a run: of cameras against lidars, and of lidars against each other."""
