"""Expected and found values of settings, in plain words."""

from dataclasses import dataclass
from pathlib import Path
from types import NoneType
from typing import Any, Literal, NamedTuple, get_args, get_origin

import yaml

from pipeline.core.settings.validation.schema import Place, fields_by_key

__all__ = ["Noun", "expected", "found"]

MAX_FOUND = 120
"""Characters of a value that are quoted."""


@dataclass(frozen=True, slots=True)
class Noun:
    """What a text stands for, in messages: one of them, several of them, and an example."""

    one: str
    many: str
    example: str = ""


class _Words(NamedTuple):
    one: str
    many: str


def expected(place: Place) -> str:
    """The expected value at a place, as in `a number above 0`."""
    words = _words(place)
    element = place.element
    nouns = [one for one in element.metadata if isinstance(one, Noun)] if element else []
    return words.one + "".join(f", for instance [{noun.example}]" for noun in nouns[:1] if noun.example)


def found(value: object) -> str:
    """A value as it would be written in YAML, on one line; a section by its keys."""
    if isinstance(value, dict):
        text = f"a section with the keys {', '.join(map(str, value))}" if value else "an empty section"
    elif isinstance(value, str):
        text = repr(value)
    else:
        plain = list(value) if isinstance(value, tuple) else value
        try:
            dumped = yaml.safe_dump(plain, default_flow_style=True, width=10**6, allow_unicode=True)
        except yaml.YAMLError:  # not from a file: a value of Python
            dumped = repr(plain)
        text = dumped.removesuffix("\n").removesuffix("\n...")
    return text if len(text) <= MAX_FOUND else f"{text[:MAX_FOUND]}..."


def _words(place: Place) -> _Words:
    kind, arguments = place.annotation, get_args(place.annotation)
    if noun := next((one for one in place.metadata if isinstance(one, Noun)), None):
        return _Words(noun.one, noun.many)
    if len(place.members) > 1:
        words = [_words(member) for member in place.members]
        return _Words(" or ".join(one for one, _ in words), " or ".join(many for _, many in words))
    if place.section is not None:
        keys = ", ".join(fields_by_key(place.section))
        return _Words(f"a section with the keys {keys}", f"sections with the keys {keys}")
    if get_origin(kind) is Literal:
        choices = ", ".join(map(_plain, arguments))
        return _Words(f"one of {choices}" if len(arguments) > 1 else choices, f"values out of {choices}")
    if get_origin(kind) in (tuple, list):
        return _listed(place, arguments)
    if get_origin(kind) is dict:
        many = _words(Place.of(arguments[1])).many
        return _Words(f"a section of names with {many}", f"sections of names with {many}")
    return _scalar(place)


def _listed(place: Place, arguments: tuple[Any, ...]) -> _Words:
    many = _words(Place.of(arguments[0])).many
    least = _said(place.metadata, "min_length")
    at_least = "" if least is None else f"at least {least} "
    number = at_least if place.element else f"{len(arguments)} "
    return _Words(f"a list of {number}{many}", f"lists of {number}{many}")


def _scalar(place: Place) -> _Words:
    bounds = _bounds(place.metadata)
    if (pattern := _said(place.metadata, "pattern")) is not None:
        return _Words(f"text of the form {pattern}", f"texts of the form {pattern}")
    one, many = _SCALARS.get(place.annotation, _Words("a value", "values"))
    return _Words(one + bounds, many + bounds)


_SCALARS: dict[Any, _Words] = {
    bool: _Words("true or false", "values true or false"),
    int: _Words("a whole number", "whole numbers"),
    float: _Words("a number", "numbers"),
    str: _Words("text", "texts"),
    Path: _Words("the path of a file", "paths of files"),
    NoneType: _Words("null", "nulls"),
}


def _bounds(metadata: tuple[Any, ...]) -> str:
    limits = {name: limit for name in _BOUNDS if (limit := _said(metadata, name)) is not None}
    if {"ge", "le"} <= limits.keys():
        return f" from {limits['ge']:g} to {limits['le']:g}"
    return " and".join(f" {_BOUNDS[name].format(limit)}" for name, limit in limits.items())


_BOUNDS = {"gt": "above {:g}", "ge": "of {:g} or more", "lt": "below {:g}", "le": "of {:g} or less"}


def _said(metadata: tuple[Any, ...], name: str) -> Any:
    """The metadata under a name, such as `gt` or `min_length`; None if there are none."""
    return next((said for one in metadata if (said := getattr(one, name, None)) is not None), None)


def _plain(value: object) -> str:
    return value if isinstance(value, str) else found(value)
