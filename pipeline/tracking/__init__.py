"""Tracks: which objects of different frames are one object, where it was at every moment, and how it moved."""
