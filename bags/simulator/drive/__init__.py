"""Driving the cars of a scenario by keys."""
