"""Tracks against truth: HOTA, CLEAR MOT, IDF1, AMOTA, and heading flips."""
