"""Positions of the objects of 2D boxes by cameras alone."""
