"""Tracks against truth: HOTA, CLEAR MOT, IDF1, and heading flips."""
