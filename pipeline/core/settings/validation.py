"""Checks a tree of settings against its model: one line with the key, what is expected, what was found, what was meant.

Expected values are in the words of pydantic, made plainer where Python's own types show.
"""

import re
from collections.abc import Iterator, Mapping
from difflib import get_close_matches
from typing import Any, TypeVar, get_args

import yaml
from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo

from lidcam.pipeline.core.errors import ConfigError, LidcamError

M = TypeVar("M", bound=BaseModel)

MAX_FOUND = 120
"""Characters of a value that are quoted."""

Part = int | str

_PLAIN = {
    "Input should be ": "",
    "Value should have": "a value with",
    "List should have": "a list with",
    "Tuple should have": "a list with",
    "String should match pattern": "text of the form",
    "a valid dictionary": "a section",
    "a valid tuple": "a list",
    "a valid list": "a list",
    "a valid boolean": "true or false",
    "a valid integer": "a whole number",
    "a valid number": "a number",
    "a valid string": "text",
    "greater than or equal to ": "at least ",
    "less than or equal to ": "at most ",
    "greater than ": "above ",
    "less than ": "below ",
    " after validation": "",
    "Field required": "a longer list",
}
"""Phrases of pydantic, and what stands in their place."""


def fields_by_key(model: type[BaseModel]) -> dict[str, FieldInfo]:
    """The fields of a model by their keys in a tree: their names, or the words that Python keeps for itself."""
    return {field.alias or name: field for name, field in model.model_fields.items()}


def section_of(annotation: Any) -> type[BaseModel] | None:
    """The model of a section, or of the elements of a list or a mapping; None for a single value."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    return next((found for part in get_args(annotation) if (found := section_of(part))), None)


def keys_of(model: type[BaseModel]) -> Iterator[str]:
    """Every key of a model, sections before what they hold; `*` stands for any element: `classes.*.name`."""
    for key, field in fields_by_key(model).items():
        yield key
        if section := section_of(field.annotation):
            infix = "" if section is field.annotation else ".*"
            yield from (f"{key}{infix}.{nested}" for nested in keys_of(section))


def checked(model: type[M], tree: Mapping[str, Any], source: object, error: type[LidcamError] = ConfigError) -> M:
    """The settings in a tree; `source` names it in messages: a file, or `settings`.

    Raises:
        LidcamError: (`error`) a key is unknown or missing, or a value does not fit; the first, and how many more.
    """
    try:
        return model.model_validate(tree)
    except ValidationError as err:
        message = _first_mistake(model, tree, err)
    raise error(f"{source}: {message}")  # not from `err`: its message is the validation library's


def did_you_mean(word: str, known: list[str]) -> str:
    """`: did you mean 'x'?`, or nothing if no known word is like this one."""
    alike = get_close_matches(word, known, n=1)
    return f": did you mean {alike[0]!r}?" if alike else ""


def unknown_key(model: type[BaseModel], path: tuple[Part, ...], more: str = "") -> str:
    """The message about an unknown key: what became of it, the key that was probably meant, or the known ones."""
    key, leaf = _dotted(path), str(path[-1])
    for end in range(len(path), 0, -1):
        if gone := getattr(model, "GONE", {}).get(_dotted(path[:end])):
            return f"{key} is gone: {gone}{more}"
    section, before = model, f"{_dotted(path[:-1])}." if path[:-1] else ""
    for part in path[:-1]:
        field = fields_by_key(section).get(str(part))  # None: the index or the name of an element
        section = (section_of(field.annotation) if field else None) or section
    siblings, known = list(fields_by_key(section)), [name for name in keys_of(model) if "*" not in name]
    near = [name for name in known if not before or name.startswith(f"{path[0]}.")]
    same = [name for name in near if name.endswith(f".{leaf}")]
    leaves = {name.rpartition(".")[2]: name for name in near}
    beside = [f"{before}{name}" for name in get_close_matches(leaf, siblings, 1)]
    meant = same or beside or [leaves[name] for name in get_close_matches(leaf, leaves, 1)]
    hint = f": did you mean {' or '.join(map(repr, meant))}?" if meant else f"; known here: {', '.join(siblings)}"
    return f"unknown key {key!r}{more}{hint}"


def _first_mistake(model: type[BaseModel], tree: Mapping[str, Any], err: ValidationError) -> str:
    mistakes = err.errors(include_url=False)
    paths = [path_in(tree, one["loc"]) for one in mistakes]
    for row, one in enumerate(mistakes):
        if one["type"] == "missing" and paths[row] == one["loc"][:-1]:  # else a type of a union is between
            paths[row] = one["loc"]
    first, path = mistakes[0], paths[0]
    more = f" (and {len({*paths}) - 1} more)" if len({*paths}) > 1 else ""
    key = f"{_dotted(path)}: " if path else ""
    match first["type"]:
        case "extra_forbidden":
            return unknown_key(model, path, more)
        case "missing" if path == first["loc"]:
            return f"{_dotted(path)} is missing{more}"
        case "value_error":  # a check of our own
            return f"{key}{first['ctx']['error']}{more}"
    # A value that fits no member of a union gives one mistake per member.
    expected = " or ".join(dict.fromkeys(_plain(one) for one, at in zip(mistakes, paths, strict=True) if at == path))
    value: Any = tree
    for part in path:
        value = value[part]
    if first["loc"][-1:] == ("[key]",):
        value = path[-1]
    return f"{key}expected {expected}, found {found(value)}{more}"


def path_in(tree: Any, loc: tuple[Part, ...]) -> tuple[Part, ...]:
    """The part of pydantic's place of a mistake that leads to a value in the tree: what follows are types."""
    for depth, part in enumerate(loc):
        try:
            tree = tree[part]
        except (IndexError, KeyError, TypeError):
            return loc[:depth]
    return loc


def _plain(mistake: Any) -> str:
    text: str = re.split(", unable|, got|, not|, found| or instance of", mistake["msg"])[0]
    for phrase, plain in _PLAIN.items():
        text = text.replace(phrase, plain)
    return text


def _dotted(path: tuple[Part, ...]) -> str:
    return ".".join(map(str, path))


def found(value: object) -> str:
    """A value as it would be written in YAML, on one line; a section by its keys."""
    if isinstance(value, dict):
        text = f"a section with the keys {', '.join(map(str, value))}" if value else "an empty section"
    elif isinstance(value, str):
        text = repr(value)
    else:
        try:
            plain = list(value) if isinstance(value, tuple) else value
            dumped = yaml.safe_dump(plain, default_flow_style=True, width=10**6, allow_unicode=True)
            text = dumped.removesuffix("\n").removesuffix("\n...")
        except yaml.YAMLError:  # not from a file: a value of Python
            text = repr(value)
    return text if len(text) <= MAX_FOUND else f"{text[:MAX_FOUND]}..."
