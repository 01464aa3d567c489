"""Matching of 3D boxes with 2D boxes: what is hidden, which pairs are likely, what other cameras say."""
