"""Scenarios: the settings of a simulated recording."""
