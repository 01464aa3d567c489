"""Matching of 3D boxes with 2D boxes: occlusion, likelihood of pairs, agreement with other cameras."""
