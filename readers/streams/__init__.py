"""One stream per sensor: combined messages split, packets gathered, motion, decoders."""
