"""Driving the cars of a scenario with the keyboard."""
