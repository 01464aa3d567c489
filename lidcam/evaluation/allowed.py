"""Differences between two results that may be allowed."""

from enum import StrEnum


class AllowedDifference(StrEnum):
    """Kinds of differences between two results that may be allowed, and frames of one result alone."""

    LOST = "lost"
    NEW = "new"
    MOVED = "moved"
    TURNED = "turned"
    RESIZED = "resized"
    RELABELLED = "relabelled"
    RESCORED = "rescored"
    REIDENTIFIED = "reidentified"
    FRAMES = "frames"
