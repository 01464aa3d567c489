"""Rigs that travel with lidcam, by name: the files of `config/rigs`."""

from os import PathLike, fspath
from pathlib import Path

from pipeline.core.errors import CalibrationError

__all__ = ["preset_rigs", "rig_path"]


def rig_path(name: str | PathLike[str]) -> Path:
    """The rig file of a path, or of the name of a preset; a file of that name comes first.

    Raises:
        CalibrationError: it is a mere name, of no preset and of no file.
    """
    path = Path(fspath(name))
    if path.exists() or path.suffix or len(path.parts) > 1:
        return path
    presets = preset_rigs()
    if path.name not in presets:
        names = ", ".join(presets)
        raise CalibrationError(f"{path}: expected a rig file or the name of a preset ({names}), found neither")
    return presets[path.name]


def preset_rigs() -> dict[str, Path]:
    """The rigs by name."""
    return {path.stem: path for path in sorted(_folder().glob("*.yaml"))}


def _folder() -> Path:
    """The folder of rigs: in the installed package, or `config/` in a checkout."""
    installed = Path(__file__).parent / "rig_files"
    return installed if installed.is_dir() else Path(__file__).parents[2] / "config" / "rigs"
