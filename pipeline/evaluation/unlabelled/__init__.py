"""Figures of results without truth: how steady objects are, how many there are, how sensors agree."""
