"""rosbags' types, of which all is made when it is used: classes, readers and writers.

rosbags makes a dataclass of each of the 300 types of a release, and fourteen functions for each type that is read or
written, and for each type within it. A run needs some dozens of the classes, and one or two of the functions: to make
all of them took a third of a second of every start.
"""

import builtins
import dataclasses
from collections.abc import Callable, Mapping
from functools import cache, partial
from importlib.util import find_spec, module_from_spec
from types import SimpleNamespace
from typing import Any

from rosbags.interfaces import Msgdef, Nodetype
from rosbags.interfaces.typing import Fielddefs, Typesdict
from rosbags.serde.cdr import generate_deserialize_cdr, generate_getsize_cdr, generate_serialize_cdr
from rosbags.serde.ros1 import generate_deserialize_ros1, generate_getsize_ros1, generate_serialize_ros1
from rosbags.typesys import Stores
from rosbags.typesys.base import normalize_fieldname
from rosbags.typesys.store import Typestore

from pipeline.core.ros.made_later import MadeLater

__all__ = ["LazyTypestore", "lazy_typestore"]

_STORES = "rosbags.typesys.stores"

_NO_FIELDS = [("structure_needs_at_least_one_member", (Nodetype.BASE, ("uint8", 0)))]

_MAKERS: Mapping[str, Callable[[Fielddefs, Typestore], Any]] = {
    "size_cdr": lambda fields, store: generate_getsize_cdr(fields, store)[1],
    "getsize_cdr": lambda fields, store: generate_getsize_cdr(fields, store)[0],
    "serialize_cdr_le": lambda fields, store: generate_serialize_cdr(fields, store, "le"),
    "serialize_cdr_be": lambda fields, store: generate_serialize_cdr(fields, store, "be"),
    "deserialize_cdr_le": lambda fields, store: generate_deserialize_cdr(fields, store, "le"),
    "deserialize_cdr_be": lambda fields, store: generate_deserialize_cdr(fields, store, "be"),
    "size_ros1": lambda fields, store: generate_getsize_ros1(fields, store)[1],
    "getsize_ros1": lambda fields, store: generate_getsize_ros1(fields, store)[0],
    "serialize_ros1": generate_serialize_ros1,
    "deserialize_ros1": generate_deserialize_ros1,
}


class LazyTypestore(Typestore):
    """A type store that makes what is asked for; it converts nothing between ROS 1 and CDR byte by byte."""

    def __init__(self, release: Any) -> None:
        super().__init__()
        self.fielddefs = MadeLater(release.FIELDDEFS)
        classes = {name: getattr(release, name.replace("/", "__")) for name in self.fielddefs}
        self.types = MadeLater({}, {name: partial(_dataclass, plain) for name, plain in classes.items()})

    def know(self, types: Typesdict) -> None:
        """As `register`, but without a look at the types: they are sound, and others than those of the store."""

        def fields(name: str) -> Any:
            constants, fields = types[name]
            return constants, fields or _NO_FIELDS

        def message_class(name: str) -> Any:
            store = Typestore()
            store.register({name: types[name]})
            return store.types[name]

        self.fielddefs = MadeLater(self.fielddefs, {name: partial(fields, name) for name in types})
        self.types = MadeLater(self.types, {name: partial(message_class, name) for name in types})

    def get_msgdef(self, typename: str) -> Msgdef[object]:
        """How messages of the type are read and written."""
        if typename not in self.cache:
            fields = [(normalize_fieldname(name), kind) for name, kind in self.fielddefs[typename][1]]
            self.cache[typename] = _LazyMsgdef(typename, fields, self)
        return self.cache[typename]


def lazy_typestore(name: Stores) -> LazyTypestore:
    """The types of a ROS release, as rosbags' `get_typestore`."""
    return LazyTypestore(_release(name.value))


@cache
def _release(name: str) -> Any:
    """A module of rosbags with the types of a release, its classes not yet made dataclasses."""

    def importing(module: str, *place: Any) -> Any:
        _, _, names, level = (*place, None, None, (), 0)[:4]
        if module == "dataclasses":
            return SimpleNamespace(**vars(dataclasses) | {"dataclass": _same})
        if level == 1 and not module:  # the releases that this one adds to
            return SimpleNamespace(**{base: _release(base) for base in names})
        return __import__(module, *place)

    spec = find_spec(f"{_STORES}.{name}")
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    vars(module)["__builtins__"] = vars(builtins) | {"__import__": importing}
    spec.loader.exec_module(module)
    return module


def _dataclass(plain: type[Any]) -> type[Any]:
    plain.__module__ = _STORES  # where Python looks for what types are annotated with: its own was never imported
    return dataclasses.dataclass(plain)


def _same(plain: Any = None, **_: Any) -> Any:
    return _same if plain is None else plain


class _LazyMsgdef(Msgdef[object]):
    """A definition whose parts are made at their first use."""

    def __init__(self, name: str, fields: Fielddefs, store: LazyTypestore) -> None:
        self.__dict__.update(name=name, fields=fields, _store=store)

    def __getattr__(self, part: str) -> Any:
        store = self.__dict__["_store"]
        if part == "cls":
            found = store.types[self.name]
        elif part in _MAKERS:
            found = _MAKERS[part](self.fields, store)
        else:
            raise AttributeError(part)
        self.__dict__[part] = found
        return found
