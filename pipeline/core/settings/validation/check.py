"""Checks a tree of settings against its model; mistakes are reported in plain words, with the key that may be meant."""

from collections.abc import Mapping
from difflib import get_close_matches
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from pipeline.core.errors import ConfigError, LidcamError
from pipeline.core.settings.validation.schema import Part, Place, fields_by_key, key_places
from pipeline.core.settings.validation.wording import expected, found

__all__ = ["checked", "did_you_mean", "unknown_key"]

M = TypeVar("M", bound=BaseModel)

SIBLING_LIKENESS, KEY_LIKENESS = 0.6, 0.9
"""How alike two keys of one section, and two keys with all their sections, are at least."""


def checked(model: type[M], tree: Mapping[str, Any], source: object, error: type[LidcamError] = ConfigError) -> M:
    """The settings in a tree.

    Args:
        model: What they may be.
        tree: Their values.
        source: Where they come from, for messages: a file, or `settings`.
        error: What is raised.

    Raises:
        LidcamError: a key is unknown or missing, or a value does not fit; the first of them, and how many more.
    """
    try:
        return model.model_validate(tree)
    except ValidationError as err:
        message = _first_mistake(model, tree, err)
    raise error(f"{source}: {message}")  # not from `err`: its message is the validation library's


def did_you_mean(word: str, known: list[str], likeness: float = SIBLING_LIKENESS) -> str:
    """`: did you mean 'x'?`, or nothing if no known word is like this one."""
    alike = get_close_matches(word, known, n=1, cutoff=likeness)
    return f": did you mean {alike[0]!r}?" if alike else ""


def unknown_key(model: type[BaseModel], path: tuple[Part, ...], more: str = "") -> str:
    """The message about an unknown key: the one that was probably meant, else the known ones."""
    key, leaf = _dotted(path), str(path[-1])
    section = Place.of(model).at(path[:-1])[1].section or model
    if gone := getattr(section, "GONE", {}).get(leaf):
        return f"unknown key {key!r}{more}: {gone}"
    siblings, before = list(fields_by_key(section)), _dotted(path[:-1])
    everywhere = [known for known, _ in key_places(model) if "*" not in known]
    under = {known.split(".")[-1]: known for known in everywhere if known.split(".")[0] == str(path[0])}
    beside = get_close_matches(leaf, siblings, n=1, cutoff=SIBLING_LIKENESS)
    meant = (
        [under[leaf]]
        if leaf in under
        else [f"{before}.{name}" if before else name for name in beside]
        or [under[name] for name in get_close_matches(leaf, under, n=1, cutoff=SIBLING_LIKENESS)]
        or get_close_matches(key, everywhere, n=1, cutoff=KEY_LIKENESS)
    )
    hint = f": did you mean {meant[0]!r}?" if meant else f"; known here: {', '.join(siblings)}"
    return f"unknown key {key!r}{more}{hint}"


def _first_mistake(model: type[BaseModel], tree: Mapping[str, Any], err: ValidationError) -> str:
    root = Place.of(model)
    mistakes = err.errors(include_url=False)
    fault = mistakes[0]
    # A value that fits no member of a union gives one mistake per member: count them as one.
    keys = {one["loc"] if one["type"] == "extra_forbidden" else root.at(one["loc"])[0] for one in mistakes}
    more = f" (and {len(keys) - 1} more)" if len(keys) > 1 else ""
    path, place = root.at(fault["loc"])
    key = _dotted(path)
    prefix = f"{key}: " if key else ""
    match fault["type"]:
        case "extra_forbidden":
            return unknown_key(model, fault["loc"], more)
        case "missing":
            return f"{key} is missing: expected {expected(place)}{more}"
        case "value_error":  # a check of our own
            return f"{prefix}{fault['ctx']['error']}{more}"
        case "finite_number":
            return f"{key}: expected a finite number, found {found(fault['input'])}{more}"
    if fault["loc"][-1:] == ("[key]",):
        return f"{key}: expected a name of letters, digits and _, found {found(fault['input'])}{more}"
    # A member of a union lies deeper than its value; elsewhere the tree may have another form than what was checked.
    value = fault["input"] if path == fault["loc"] else _value_at(tree, path)
    return f"{prefix}expected {expected(place)}, found {found(value)}{more}"


def _value_at(tree: Any, path: tuple[Part, ...]) -> Any:
    for part in path:
        tree = tree[part]
    return tree


def _dotted(path: tuple[Part, ...]) -> str:
    return ".".join(map(str, path))
