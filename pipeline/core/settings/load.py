"""Settings read from YAML and from single values, and written back to YAML."""

from collections.abc import Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Any, get_args

import yaml
from pydantic import BaseModel, ValidationError

from pipeline.core.errors import ConfigError
from pipeline.core.settings.bounded_yaml import parse_yaml, read_yaml
from pipeline.core.settings.config import Config

__all__ = ["describe_validation", "dump_config", "load_config", "set_values"]


def load_config(
    base: Config | str | PathLike[str] | None = None, settings: Mapping[str, object] | Sequence[str] = ()
) -> Config:
    """The defaults, or other settings, or a YAML file of them; then single settings on top.

    Args:
        base: Settings, or a YAML file; None: the defaults.
        settings: `{"sync.slop_s": 0.05}`, or `["sync.slop_s=0.05"]` whose values are YAML.

    Raises:
        ConfigError: the file cannot be read, a key is unknown, or a value does not fit.
    """
    tree = base.model_dump() if isinstance(base, Config) else {} if base is None else read_yaml(Path(base))
    set_values(tree, settings)
    try:
        return Config.model_validate(tree)
    except ValidationError as err:
        where = "settings" if base is None or isinstance(base, Config) else base
        raise ConfigError(f"{where}: {describe_validation(Config, err)}") from err


def set_values(tree: dict[str, Any], settings: Mapping[str, object] | Sequence[str]) -> None:
    """Put single settings into a tree of them.

    Args:
        tree: Changed in place.
        settings: `{"a.b": value}`, or `["a.b=value"]` whose values are YAML.

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
            nested = branch.setdefault(parent, {})
            if not isinstance(nested, dict):
                raise ConfigError(f"--set {key}: {parent!r} is a value, not a section")
            branch = nested
        branch[leaf] = value


def _parsed(setting: str) -> tuple[str, Any]:
    key, separator, text = setting.partition("=")
    if not separator or not key:
        raise ConfigError(f"--set {setting}: expected key.key=value")
    try:
        return key, parse_yaml(text)
    except yaml.YAMLError as err:
        raise ConfigError(f"--set {setting}: the value is not YAML") from err


def dump_config(config: Config) -> str:
    """All settings as YAML, for `load_config`; `config/default.yaml` is `dump_config(Config())`."""
    text: str = yaml.safe_dump(config.model_dump(mode="json"), sort_keys=False, default_flow_style=None, width=100)
    return text


def describe_validation(model: type[BaseModel], err: ValidationError) -> str:
    """The first error of a validation in one line; for an unknown key, with the known ones."""
    fault = err.errors()[0]
    key = ".".join(str(part) for part in fault["loc"])
    more = f" (and {err.error_count() - 1} more)" if err.error_count() > 1 else ""
    if fault["type"] == "extra_forbidden":
        return f"unknown key {key!r}{more}; known here: {', '.join(_known_keys(model, fault['loc']))}"
    if fault["type"] == "value_error" and not key:  # a check across keys: its message names them
        return f"{fault['ctx']['error']}{more}"
    found = repr(fault.get("input"))
    return f"{key}: {fault['msg']}, found {found if len(found) <= 200 else found[:200] + '...'}{more}"


def _known_keys(model: type[BaseModel], location: tuple[int | str, ...]) -> list[str]:
    """Keys of the section that contains the last part of `location`."""
    for part in location[:-1]:
        if field := model.model_fields.get(str(part)):
            model = _model_in(field.annotation) or model
    return list(model.model_fields)


def _model_in(annotation: Any) -> type[BaseModel] | None:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    return next((model for part in get_args(annotation) if (model := _model_in(part)) is not None), None)
