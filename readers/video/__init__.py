"""Packets of video to images."""
