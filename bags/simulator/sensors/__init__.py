"""Simulated lidars and cameras, their timing and their faults."""
