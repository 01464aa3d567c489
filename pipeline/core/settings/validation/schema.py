"""Places in a tree of settings: the type of the value at each key, read from the models themselves."""

from collections.abc import Iterator
from dataclasses import dataclass
from types import UnionType
from typing import Annotated, Any, Union, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

__all__ = ["Part", "Place", "fields_by_key", "key_places"]

Part = int | str


@dataclass(frozen=True, slots=True)
class Place:
    """A place in a tree of settings.

    Attributes:
        annotation: Type of its value, without `Annotated`.
        metadata: What `Annotated` and `Field` say of it: bounds, lengths, nouns.
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
