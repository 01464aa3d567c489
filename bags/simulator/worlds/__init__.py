"""Worlds drawn from a seed: for recordings, and for training."""
