"""Settings read from YAML and from single values, and written back to YAML."""

from collections.abc import Mapping, Sequence
from os import PathLike, fspath
from typing import Any

import yaml

from lidcam.pipeline.core.errors import ConfigError
from lidcam.pipeline.core.settings.bounded_yaml import parse_yaml, read_yaml
from lidcam.pipeline.core.settings.bundled import settings_file
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.core.settings.validation import checked


def load_config(
    base: Config | str | PathLike[str] | None = None, settings: Mapping[str, object] | Sequence[str] = ()
) -> Config:
    """The defaults, or other settings, or a preset or YAML file of them; then single settings on top.

    Args:
        base: Settings, the name of a preset, or a YAML file; None: the defaults.
        settings: `{"sync.slop_s": 0.05}`, or `["sync.slop_s=0.05"]` whose values are YAML.

    Raises:
        ConfigError: the file cannot be read, a key is unknown, or a value does not fit.
    """
    tree = base.model_dump() if isinstance(base, Config) else {} if base is None else read_yaml(settings_file(base))
    set_values(tree, settings)
    if base is None or isinstance(base, Config):
        source = "settings"
    else:
        source = f"{fspath(base)} with settings" if settings else fspath(base)
    return checked(Config, tree, source)


def set_values(tree: dict[str, Any], settings: Mapping[str, object] | Sequence[str]) -> None:
    """Put single settings, `{"a.b": value}` or `["a.b=value"]` with values in YAML, into a tree of them, in place.

    Raises:
        ConfigError: a setting does not have this form, or leads through a value.
    """
    if isinstance(settings, str):
        settings = [settings]
    pairs = settings.items() if isinstance(settings, Mapping) else map(_parsed, settings)
    for key, value in pairs:
        *parents, leaf = key.split(".")
        branch = tree
        for parent in parents:
            nested = branch.get(parent, {})
            if not isinstance(nested, dict):
                raise ConfigError(f"settings: {key}: {parent!r} is a value, not a section")
            branch[parent] = dict(nested)  # anchors of YAML make several sections one
            branch = branch[parent]
        branch[leaf] = value


def _parsed(setting: str) -> tuple[str, Any]:
    key, separator, text = setting.partition("=")
    if not separator or not key:
        raise ConfigError(f"settings: {setting}: expected key.key=value")
    try:
        return key, parse_yaml(text)
    except yaml.YAMLError as err:
        raise ConfigError(f"settings: {setting}: the value is not YAML") from err


def dump_config(config: Config) -> str:
    """All settings as YAML, for `load_config`; `config/default.yaml` is `dump_config(Config())`."""
    tree = config.model_dump(mode="json")
    text: str = yaml.dump(tree, Dumper=yaml.CSafeDumper, sort_keys=False, default_flow_style=None, width=100)
    return text
