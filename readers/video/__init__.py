"""Packets of video to pictures."""
