"""Wrong values for every key of a model of settings, and the words that must not tell of them."""

import datetime
import re
from collections.abc import Callable, Iterator, Mapping
from typing import Any

from pydantic import BaseModel
from pydantic_core._pydantic_core import list_all_errors

from lidcam.pipeline.core.errors import LidcamError
from lidcam.pipeline.core.settings.validation import Place, key_places

WRONG: tuple[Any, ...] = (
    None,
    True,
    -3,
    2.5,
    1e9,
    float("inf"),
    float("nan"),
    "no such thing",
    "",
    [],
    [1, 2, "x"],
    [["x"]],
    [None] * 4,
    {},
    {"no_such_key": 1},
    {1: 2},
    datetime.date(2024, 1, 1),
)

LIBRARY_WORDS = sorted(
    {
        fragment.strip()
        for error in list_all_errors()
        for fragment in re.split(r"\{.*?\}", error["message_template_python"])
        if " " in fragment.strip()
    }
    | {"Input", "should be", "pydantic", "Value error"}
)


def mistakes(model: type[BaseModel], check: Callable[[Mapping[str, Any]], object]) -> list[tuple[str, str]]:
    """What a check says of values that may be wrong: the key that they are at, and the message of each that is."""
    told = []
    for key, tree in _wrong_trees(model):
        try:
            check(tree)
        except LidcamError as err:
            told.append((key, str(err)))
    return told


def words_of_the_library(told: list[tuple[str, str]]) -> list[tuple[str, str]]:
    """Those messages that have words of the library in them."""
    return [(key, text) for key, text in told if any(words in text for words in LIBRARY_WORDS)]


def _wrong_trees(model: type[BaseModel]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Every key of a model with a tree that has a value there which may be wrong."""
    for key, _ in key_places(model):
        for value in WRONG:
            names, tree = _nested(Place.of(model), key.split("."), value)
            yield ".".join(names), tree


def _nested(place: Place, parts: list[str], value: Any) -> tuple[list[str], Any]:
    if not parts:
        return [], value
    part, *rest = parts
    if part != "*":
        inner = place.inner(part)
        assert inner is not None
        names, tree = _nested(inner, rest, value)
        return [part, *names], {part: tree}
    assert place.element is not None
    names, tree = _nested(place.element, rest, value)
    if place.inner(0) is None:
        return ["a_name", *names], {"a_name": tree}
    return ["0", *names], [tree]
