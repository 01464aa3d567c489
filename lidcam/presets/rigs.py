"""Rigs that travel with lidcam, by name: the files of `config/rigs`."""

from os import PathLike
from pathlib import Path

from pipeline.core.errors import CalibrationError
from pipeline.core.settings.bundled import bundled, preset_or_file

__all__ = ["preset_rigs", "rig_path"]


def rig_path(name: str | PathLike[str]) -> Path:
    """The file of a preset, or the file of that name.

    Raises:
        CalibrationError: it is neither.
    """
    return preset_or_file(name, preset_rigs(), "a rig file", CalibrationError)


def preset_rigs() -> dict[str, Path]:
    """The rigs by name."""
    return {path.stem: path for path in sorted(bundled("rigs").glob("*.yaml"))}
