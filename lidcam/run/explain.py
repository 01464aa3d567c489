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
from lidcam.pipeline.core.settings.model import MAX_NUMBER
from lidcam.pipeline.core.settings.validation import section_of, unknown_key
from lidcam.run.options import attribute_docs

UNITS = {
    "per_m": "per metre",
    "per_sr": "per steradian",
    "deg": "degrees",
    "px": "pixels",
    "s": "seconds",
    "m": "metres",
}
"""Units by the end of a key, longer ones first."""

_NOUNS = {
    "boolean": "true or false",
    "integer": "whole number",
    "number": "number",
    "string": "text",
    "null": "null",
    "array": "list",
    "object": "section",
}
_BOUNDS = {"exclusiveMinimum": "above", "minimum": "at least", "exclusiveMaximum": "below", "maximum": "at most"}


@dataclass(frozen=True, slots=True)
class Explanation:
    """Explanation of a key of the settings."""

    key: str  # The key, with `*` for the elements of a list or mapping; empty for all settings
    meaning: str  # Its meaning
    unit: str = ""  # Unit of its value; empty where it has none
    allowed: str = ""  # Its allowed values; empty for a section
    default: Any = None  # Its default, as plain values; None where every element of a list has its own
    # Its value in each preset; empty where `default` is None
    by_preset: Mapping[str, Any] = field(default_factory=dict)
    keys: Mapping[str, str] = field(default_factory=dict)  # The keys of a section, with their meaning


def explain(key: str = "") -> Explanation:
    """Explain a key; the key of an element of a list may leave out which one (`classes.size_m`).

    Raises:
        ConfigError: there is no such key; names the one that was probably meant.
    """
    owner: type[BaseModel] | None = None
    section: type[BaseModel] | None = Config
    is_list, names = False, list[str]()
    for part in key.split(".") if key else ():
        if section is None or (part not in section.model_fields and not is_list):
            raise ConfigError(unknown_key(Config, tuple(key.split("."))))
        if is_list:
            is_list = False
            names.append("*")
            if part not in section.model_fields:
                continue  # an index or a name: any of them
        annotation = section.model_fields[part].annotation
        owner, section = section, section_of(annotation)
        is_list = section is not None and section is not annotation
        names.append(part)
    is_element, field_of = "*" in names, owner if names and names[-1] != "*" else None
    return Explanation(
        ".".join(names),
        _meaning(field_of, names[-1]) if field_of else _first_paragraph(section or Config),
        next((unit for ending, unit in UNITS.items() if names and names[-1].endswith(f"_{ending}")), ""),
        _words(field_of.model_json_schema()["properties"][names[-1]]) if field_of and (not section or is_list) else "",
        None if is_element else _value(Config(), names),
        {} if is_element else {name: _value(load_config(name), names) for name in PRESETS},
        {name: _meaning(section, name) for name in section.model_fields} if section else {},
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
    section = section_of(model.model_fields[name].annotation)
    return _first_paragraph(section) if section else ""


def _first_paragraph(model: type[BaseModel]) -> str:
    return " ".join(inspect.cleandoc(model.__doc__ or "").partition("\n\n")[0].split())


def _words(schema: Mapping[str, Any]) -> str:
    if members := schema.get("anyOf"):
        return " or ".join(map(_words, members))
    if choices := schema.get("enum", [schema["const"]] if "const" in schema else []):
        return f"one of {', '.join(map(str, choices))}" if len(choices) > 1 else str(choices[0])
    words = _NOUNS[schema.get("type", "object")]
    if parts := schema.get("prefixItems"):
        return f"{words} of {len(parts)}: {_words(parts[0])}"
    if "items" in schema:
        return f"{words} of: {_words(schema['items'])}"
    bounds = {text: schema[name] for name, text in _BOUNDS.items() if schema.get(name, MAX_NUMBER) < MAX_NUMBER}
    return ", ".join([words, *(f"{text} {bound:g}" for text, bound in bounds.items())])


def _value(config: Config, names: list[str]) -> Any:
    tree: Any = config.model_dump(mode="json")
    for name in names:
        tree = tree[name]
    return tree
