"""Transforms between named frames, boxes, polygons."""
