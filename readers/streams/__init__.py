"""Streams of each sensor: combined messages taken apart, packets gathered, motion, decoders."""
