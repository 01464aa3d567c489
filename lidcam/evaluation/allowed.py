"""Differences between two results that may be allowed."""

from enum import StrEnum

AllowedDifference = StrEnum(
    "AllowedDifference", "lost new moved turned resized relabelled rescored reidentified frames"
)
"""Kinds of differences between two results that may be allowed, and frames of one result alone."""
