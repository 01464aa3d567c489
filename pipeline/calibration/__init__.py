"""Errors of calibration that a run shows: of cameras against lidars, and of lidars against each other."""
