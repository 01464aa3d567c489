"""The files of `config/`, which travel with lidcam, and the presets among them."""

from collections.abc import Mapping
from contextlib import suppress
from os import PathLike, fspath
from pathlib import Path

from lidcam.pipeline.core.errors import ConfigError, LidcamError
from lidcam.pipeline.core.settings.validation import did_you_mean

PRESETS = ("sandbox", "crossing", "road")
"""Settings for a kind of site, by name."""


def bundled(*parts: str) -> Path:
    """A file or folder of `config/`, which lies inside the package."""
    return Path(__file__).parents[3].joinpath("config", *parts)


def settings_file(name: str | PathLike[str]) -> Path:
    """The file of a preset, or the file of that name.

    Raises:
        ConfigError: it is neither.
    """
    return preset_or_file(name, {preset: bundled(f"{preset}.yaml") for preset in PRESETS}, "a YAML file", ConfigError)


def preset_or_file(name: str | PathLike[str], presets: Mapping[str, Path], kind: str, error: type[LidcamError]) -> Path:
    """The file of a preset, or the file of that name, which is a `kind` in words; raises `error` if it is neither."""
    if not isinstance(name, str | PathLike):
        remedy = "; single values go into settings, as {'track.mode': 'none'}" if isinstance(name, Mapping) else ""
        raise error(f"expected a preset ({', '.join(presets)}) or {kind}, found {type(name).__name__}{remedy}")
    text = fspath(name)
    path = presets.get(text, Path(text))
    with suppress(OSError):  # a name that no file can have
        if path.exists():
            return path
    meant = did_you_mean(path.stem, [*presets])
    raise error(f"{text}: expected a preset ({', '.join(presets)}) or {kind}, found neither{meant}")
