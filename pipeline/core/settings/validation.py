"""Checks a tree of settings against its model; mistakes are reported in plain words, with the key that may be meant.

The types, bounds and names of the values are read from the models.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, NamedTuple, TypeVar, Union, get_args, get_origin

import yaml
from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo

from lidcam.pipeline.core.errors import ConfigError, LidcamError

M = TypeVar("M", bound=BaseModel)

LIKENESS = 0.6
"""Least likeness of a wrong key to the one that was probably meant, by `difflib`."""

MAX_FOUND = 120
"""Characters of a value that are quoted."""

Part = int | str

_BOUNDS = {"gt": "above {:g}", "ge": "of {:g} or more", "lt": "below {:g}", "le": "of {:g} or less"}


@dataclass(frozen=True, slots=True)
class Noun:
    """Name of a kind of text in messages: one of them, several of them, and an example."""

    one: str
    many: str
    example: str = ""


@dataclass(frozen=True, slots=True)
class Place:
    """A place in a tree of settings.

    Attributes:
        annotation: Type of its value, without `Annotated`.
        metadata: Metadata of `Annotated` and `Field`: bounds, lengths, nouns.
    """

    annotation: Any
    metadata: tuple[Any, ...] = ()

    @classmethod
    def of(cls, annotation: Any, metadata: tuple[Any, ...] = ()) -> "Place":
        """The place of a value of this type."""
        if get_origin(annotation) is Annotated:
            annotation, *more = get_args(annotation)
            metadata = (*more, *metadata)
        flat = (part for one in metadata for part in (one.metadata if isinstance(one, FieldInfo) else (one,)))
        return cls(annotation, tuple(flat))

    @property
    def members(self) -> tuple["Place", ...]:
        """The members of a union; of another type, itself."""
        if get_origin(self.annotation) not in (Union, UnionType):
            return (self,)
        return tuple(Place.of(member, self.metadata) for member in get_args(self.annotation))

    @property
    def section(self) -> type[BaseModel] | None:
        """The model, where the value is a section of known keys."""
        models = (one.annotation for one in self.members if isinstance(one.annotation, type))
        return next((model for model in models if issubclass(model, BaseModel)), None)

    @property
    def element(self) -> "Place | None":
        """The element type of a list or a mapping; None for other values, and for a list of a fixed form."""
        for member in self.members:
            arguments = get_args(member.annotation)
            if get_origin(member.annotation) is dict:
                return Place.of(arguments[1])
            if get_origin(member.annotation) is list or (arguments and arguments[-1] is ...):
                return Place.of(arguments[0])
        return None

    def inner(self, part: Part) -> "Place | None":
        """The place under a key, or of an element by its index; None if there is none."""
        if self.section is not None:
            field = fields_by_key(self.section).get(str(part))
            return None if field is None else Place.of(field.annotation, tuple(field.metadata))
        is_list = all(get_origin(member.annotation) is not dict for member in self.members)
        if is_list != isinstance(part, int):
            return None
        if self.element is not None:
            return self.element
        if len(self.members) == 1 and get_origin(self.annotation) is tuple and isinstance(part, int):
            arguments = get_args(self.annotation)
            return Place.of(arguments[part]) if part < len(arguments) else None
        return None

    def at(self, path: tuple[Part, ...]) -> "tuple[tuple[Part, ...], Place]":
        """The longest part of a path that leads to a place, and that place."""
        place, walked = self, 0
        for part in path:
            if (nested := place.inner(part)) is None:
                break
            place, walked = nested, walked + 1
        return path[:walked], place


def fields_by_key(model: type[BaseModel]) -> dict[str, FieldInfo]:
    """The fields of a model by their keys in a tree: their names, or the words that Python keeps for itself."""
    return {field.alias or name: field for name, field in model.model_fields.items()}


def key_places(model: type[BaseModel]) -> Iterator[tuple[str, Place]]:
    """Every key of a model with its place, sections before what they hold: `detect3d`, `detect3d.method` and so on.

    The elements of a list or a mapping of sections have `*` as their key: `classes.*.name`.
    """
    for name in fields_by_key(model):
        place = Place.of(model).inner(name)
        assert place is not None
        yield name, place
        for key, part in ((name, place), (f"{name}.*", place.element)):
            if part is not None and part.section is not None:
                for nested, nested_place in key_places(part.section):
                    yield f"{key}.{nested}", nested_place


def checked(model: type[M], tree: Mapping[str, Any], source: object, error: type[LidcamError] = ConfigError) -> M:
    """The settings in a tree.

    Args:
        model: Model of the settings.
        tree: Their values.
        source: Source of the values for messages: a file, or `settings`.
        error: Class of the error that is raised.

    Raises:
        LidcamError: a key is unknown or missing, or a value does not fit; the first of them, and how many more.
    """
    try:
        return model.model_validate(tree)
    except ValidationError as err:
        message = _first_mistake(model, tree, err)
    raise error(f"{source}: {message}")  # not from `err`: its message is the validation library's


def did_you_mean(word: str, known: list[str]) -> str:
    """`: did you mean 'x'?`, or nothing if no known word is like this one."""
    alike = get_close_matches(word, known, n=1, cutoff=LIKENESS)
    return f": did you mean {alike[0]!r}?" if alike else ""


def unknown_key(model: type[BaseModel], path: tuple[Part, ...], more: str = "") -> str:
    """The message about an unknown key: the one that was probably meant, or all that end in it, else the known ones."""
    key, leaf = _dotted(path), str(path[-1])
    section = Place.of(model).at(path[:-1])[1].section or model
    if gone := getattr(section, "GONE", {}).get(leaf):
        return f"unknown key {key!r}{more}: {gone}"
    siblings, before = list(fields_by_key(section)), _dotted(path[:-1])
    places = [known for known, _ in key_places(model) if "*" not in known]
    under = {known.split(".")[-1]: known for known in places if known.split(".")[0] == str(path[0])}
    beside = [f"{before}.{name}" if before else name for name in get_close_matches(leaf, siblings, 1, LIKENESS)]
    meant = (
        [under[leaf]]
        if leaf in under
        else beside or [under[name] for name in get_close_matches(leaf, under, 1, LIKENESS)]
    )
    if not meant and not before:
        meant = [known for known in places if known.split(".")[-1] == leaf]
    hint = f": did you mean {' or '.join(map(repr, meant))}?" if meant else f"; known here: {', '.join(siblings)}"
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


class _Words(NamedTuple):
    one: str
    many: str


_SCALARS: dict[Any, _Words] = {
    bool: _Words("true or false", "values true or false"),
    int: _Words("a whole number", "whole numbers"),
    float: _Words("a number", "numbers"),
    str: _Words("text", "texts"),
    Path: _Words("the path of a file", "paths of files"),
    NoneType: _Words("null", "nulls"),
}


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
        except ValueError:  # more digits than Python prints
            dumped = "a number of thousands of digits"
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


def _bounds(metadata: tuple[Any, ...]) -> str:
    limits = {name: limit for name in _BOUNDS if (limit := _said(metadata, name)) is not None}
    if {"ge", "le"} <= limits.keys():
        return f" from {limits['ge']:g} to {limits['le']:g}"
    return " and".join(f" {_BOUNDS[name].format(limit)}" for name, limit in limits.items())


def _said(metadata: tuple[Any, ...], name: str) -> Any:
    """The metadata under a name, such as `gt` or `min_length`; None if there are none."""
    return next((said for one in metadata if (said := getattr(one, name, None)) is not None), None)


def _plain(value: object) -> str:
    return value if isinstance(value, str) else found(value)
