"""Explanations of settings, from the docstrings, types and defaults of the models, and from the presets."""

import inspect
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from pydantic import BaseModel

from lidcam.pipeline.core.errors import ConfigError
from lidcam.pipeline.core.settings.bundled import PRESETS, bundled
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.core.settings.load import load_config
from lidcam.pipeline.core.settings.validation import Place, expected, unknown_key
from lidcam.run.options import attribute_docs

UNITS = {
    "per_m": "per metre",
    "per_sr": "per steradian",
    "deg": "degrees",
    "gib": "GiB",
    "mib": "MiB",
    "mpx": "millions of pixels",
    "px": "pixels",
    "ms": "milliseconds",
    "s": "seconds",
    "m": "metres",
}
"""Units by the ending of a key, longer endings first."""


@dataclass(frozen=True, slots=True)
class Explanation:
    """Explanation of a key of the settings.

    Attributes:
        key: The key, with `*` for the elements of a list or mapping; empty for all settings.
        meaning: Its meaning.
        unit: Unit of its value; empty where it has none.
        allowed: Its allowed values; empty for a section.
        default: Its default, as plain values; None where every element of a list has its own.
        by_preset: Its value in each preset; empty where `default` is None.
        keys: The keys of a section, with their meaning.
    """

    key: str
    meaning: str
    unit: str = ""
    allowed: str = ""
    default: Any = None
    by_preset: Mapping[str, Any] = field(default_factory=dict)
    keys: Mapping[str, str] = field(default_factory=dict)


def explain(key: str = "") -> Explanation:
    """Explain a key; the key of an element of a list may leave out which one (`classes.size_m`).

    Raises:
        ConfigError: there is no such key; names the one that was probably meant.
    """
    model: type[BaseModel] = Config
    place, names = Place.of(Config), list[str]()
    for part in key.split(".") if key else ():
        element = place.element
        if place.section is None and element is not None:
            place = element
            names.append("*")
            if element.section is None or part not in element.section.model_fields:
                continue  # an index or a name: any of them
        inner = place.inner(part)
        if inner is None:
            raise ConfigError(unknown_key(Config, tuple(key.split("."))))
        assert place.section is not None
        model, place = place.section, inner
        names.append(part)
    section = place.section or (place.element.section if place.element else None)
    keys = {name: _meaning(section, name) for name in section.model_fields} if section else {}
    known = {} if "*" in names else {name: _value(load_config(name), names) for name in PRESETS}
    return Explanation(
        ".".join(names),
        _meaning(model, names[-1]) if names and names[-1] != "*" else _first_paragraph(section or Config),
        _unit(names[-1] if names else ""),
        "" if place.section else expected(place),
        None if "*" in names else _value(Config(), names),
        known,
        keys,
    )


def preset_summaries() -> Mapping[str, str]:
    """The purpose of each preset: the first sentence of its file."""
    found = {}
    for name in PRESETS:
        lines = bundled(f"{name}.yaml").read_text(encoding="utf-8").splitlines()
        comment = " ".join(line.removeprefix("#").strip() for line in lines if line.startswith("#"))
        found[name] = comment.split(". ")[0].removesuffix(".")
    return found


def _meaning(model: type[BaseModel], name: str) -> str:
    """The docstring of a field in its model or in one that the model inherits from; else that of its section."""
    for owner in model.__mro__:
        if text := attribute_docs(owner).get(name):
            return text
    section = Place.of(model).at((name,))[1].section
    return _first_paragraph(section) if section else ""


def _first_paragraph(model: type[BaseModel]) -> str:
    return " ".join(inspect.cleandoc(model.__doc__ or "").partition("\n\n")[0].split())


def _unit(name: str) -> str:
    return next((unit for ending, unit in UNITS.items() if name.endswith(f"_{ending}")), "")


def _value(config: Config, names: list[str]) -> Any:
    """The value at a key as plain values."""
    tree: Any = config.model_dump(mode="json")
    for name in names:
        tree = tree[name]
    return tree
