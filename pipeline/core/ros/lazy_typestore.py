"""rosbags' types, whose readers and writers are generated when they are used.

rosbags generates fourteen functions for each type, and for each type within it, of which a run needs one or two: that
took a tenth of a second of every start.
"""

from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any

from rosbags.interfaces import Msgdef
from rosbags.interfaces.typing import Fielddefs
from rosbags.serde.cdr import generate_deserialize_cdr, generate_getsize_cdr, generate_serialize_cdr
from rosbags.serde.ros1 import generate_deserialize_ros1, generate_getsize_ros1, generate_serialize_ros1
from rosbags.typesys import Stores
from rosbags.typesys.base import normalize_fieldname
from rosbags.typesys.store import Typestore

__all__ = ["LazyTypestore", "lazy_typestore"]

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

    def get_msgdef(self, typename: str) -> Msgdef[object]:
        """How messages of the type are read and written."""
        if typename not in self.cache:
            fields = [(normalize_fieldname(name), kind) for name, kind in self.fielddefs[typename][1]]
            self.cache[typename] = _LazyMsgdef(typename, fields, self.types[typename], self)
        return self.cache[typename]


def lazy_typestore(name: Stores) -> LazyTypestore:
    """The types of a ROS release, as rosbags' `get_typestore`."""
    return LazyTypestore(import_module(f"rosbags.typesys.stores.{name.value}"))


class _LazyMsgdef(Msgdef[object]):
    """A definition whose parts are made at their first use."""

    def __init__(self, name: str, fields: Fielddefs, cls: type[object], store: LazyTypestore) -> None:
        self.__dict__.update(name=name, fields=fields, cls=cls, _store=store)

    def __getattr__(self, part: str) -> Any:
        if part not in _MAKERS:
            raise AttributeError(part)
        found = self.__dict__[part] = _MAKERS[part](self.fields, self.__dict__["_store"])
        return found
