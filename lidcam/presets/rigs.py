"""Rigs that travel with lidcam, by name: the files of `config/rigs`."""

from os import PathLike, fspath
from pathlib import Path

from pipeline.core.errors import CalibrationError
from pipeline.core.settings.bundled import bundled
from pipeline.core.settings.validation.check import did_you_mean

__all__ = ["preset_rigs", "rig_path"]


def rig_path(name: str | PathLike[str]) -> Path:
    """The file of a preset, or the file of that name.

    Raises:
        CalibrationError: it is a mere name, of no preset and of no file.
    """
    text, presets = fspath(name), preset_rigs()
    if text in presets:
        return presets[text]
    path = Path(text)
    if path.exists() or path.suffix or len(path.parts) > 1:
        return path
    names = ", ".join(presets)
    meant = did_you_mean(text, [*presets])
    raise CalibrationError(f"{text}: expected a preset ({names}) or a rig file, found neither{meant}")


def preset_rigs() -> dict[str, Path]:
    """The rigs by name."""
    return {path.stem: path for path in sorted(bundled("rigs").glob("*.yaml"))}
