"""Existence probability of a hypothesis from the evidence of all sensors."""
