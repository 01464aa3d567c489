"""Scenes of lidars, cameras and traffic, simulated and recorded."""
