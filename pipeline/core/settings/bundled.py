"""Where the files of `config/` lie, which travel with lidcam, and which of them are presets."""

from os import PathLike, fspath
from pathlib import Path

from pipeline.core.errors import ConfigError
from pipeline.core.settings.validation.check import did_you_mean

__all__ = ["PRESETS", "bundled", "settings_file"]

PRESETS = ("sandbox", "crossing", "road")
"""Settings for a kind of site, by name."""


def bundled(*parts: str) -> Path:
    """A file or folder of `config/`: inside the installed package, or beside the packages of a checkout."""
    package = Path(__file__).parents[2]
    installed = package / "config"
    return (installed if installed.is_dir() else package.parent / "config").joinpath(*parts)


def settings_file(name: str | PathLike[str]) -> Path:
    """The file of a preset, or the file of that name.

    Raises:
        ConfigError: it is neither.
    """
    text = fspath(name)
    if text in PRESETS:
        return bundled(f"{text}.yaml")
    path = Path(text)
    if path.exists():
        return path
    meant = did_you_mean(path.stem, [*PRESETS])
    raise ConfigError(f"{text}: expected a preset ({', '.join(PRESETS)}) or a YAML file, found neither{meant}")
