"""The file of a layout, by name: who tells of it needs nothing that makes it."""

from pathlib import Path

__all__ = ["LAYOUT_SUFFIX", "layout_path"]

LAYOUT_SUFFIX = ".foxglove.json"


def layout_path(path: Path) -> Path:
    """Where the layout that belongs to an MCAP file is written: beside it."""
    return path.with_suffix(LAYOUT_SUFFIX)
