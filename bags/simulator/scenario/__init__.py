"""Scenarios: what a simulated recording is made of."""
