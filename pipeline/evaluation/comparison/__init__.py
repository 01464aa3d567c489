"""Differences between two results."""
