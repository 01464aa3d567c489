"""What lidcam needs of a recorded definition: the fields that its decoders read, each of a kind that they can use.

A type's name does not say what its messages hold: a package of one's own may have a `sensor_msgs/Image` of another
layout. So a definition is compared with these needs once, when it is first used; a topic that falls short of them
cannot be decoded, for one reason, and decoders may rely on every field that they read. Further fields, other orders and
wider numbers do not matter: messages are decoded as their own definition says.

This is the first half of the line between recorded bytes and typed data; `decoding` is the other.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from rosbags.interfaces import Nodetype
from rosbags.interfaces.typing import Typesdict

__all__ = ["layout_fault"]

_WHOLE = frozenset(
    ("bool", "byte", "char", "octet", *(f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)))
)
_NUMBERS = _WHOLE | {"float32", "float64"}
_LISTS = {Nodetype.ARRAY, Nodetype.SEQUENCE}


@dataclass(frozen=True, slots=True)
class _Value:
    """A number or a text."""

    words: str
    bases: frozenset[str]


@dataclass(frozen=True, slots=True)
class _Values:
    """A list of numbers; of a fixed length unless that is 0."""

    words: str
    bases: frozenset[str]
    length: int = 0


@dataclass(frozen=True, slots=True)
class _List:
    """A list of messages."""

    item: "_Need"


@dataclass(frozen=True, slots=True)
class _Either:
    """One of several, as versions of a type differ."""

    needs: tuple["_Need", ...]


_Need = _Value | _Values | _List | _Either | Mapping[str, Any]
"""A mapping is a nested message: what is needed of its fields, by name or by several names that a field may have."""

WHOLE = _Value("a whole number", _WHOLE)
NUMBER = _Value("a number", _NUMBERS)
TEXT = _Value("a string", frozenset({"string", "wstring"}))
BYTES = _Values("uint8[]", frozenset({"uint8", "byte", "char", "octet"}))
_FLOATS = frozenset({"float32", "float64"})

TIME = {"sec": _Value("int32", frozenset({"int32", "uint32"})), "nanosec": _Value("uint32", frozenset({"uint32"}))}
HEADER = {"stamp": TIME, "frame_id": TEXT}
POINT = dict.fromkeys("xyz", NUMBER)
QUATERNION = dict.fromkeys("xyzw", NUMBER)
IMAGE = {
    "header": HEADER,
    **dict.fromkeys(("height", "width", "is_bigendian", "step"), WHOLE),
    "encoding": TEXT,
    "data": BYTES,
}
TRANSFORM = {"translation": POINT, "rotation": QUATERNION}
TRANSFORMS = {"transforms": _List({"header": HEADER, "child_frame_id": TEXT, "transform": TRANSFORM})}
HYPOTHESIS = _Either(
    (
        {"hypothesis": {"class_id": TEXT, "score": NUMBER}},
        {"id": TEXT, "score": NUMBER},
        {"id": WHOLE, "score": NUMBER},
    )
)
COVARIANCE = _Values("float64[36]", _FLOATS, 36)
POSED = {"pose": {"covariance": COVARIANCE}}
POSED_HYPOTHESIS = _Either(tuple({**need, **POSED} for need in HYPOTHESIS.needs if isinstance(need, Mapping)))
CENTER = _Either(
    ({"position": {"x": NUMBER, "y": NUMBER}, "theta": NUMBER}, dict.fromkeys(("x", "y", "theta"), NUMBER))
)
DETECTED_OBJECTS = {
    "header": HEADER,
    "objects": _List(
        {
            "existence_probability": NUMBER,
            "classification": _List({"label": WHOLE, "probability": NUMBER}),
            "kinematics": {
                "pose_with_covariance": {
                    "pose": {"position": POINT, "orientation": QUATERNION},
                    "covariance": COVARIANCE,
                },
                "has_position_covariance": WHOLE,
                "orientation_availability": WHOLE,
            },
            "shape": {
                "type": WHOLE,
                "footprint": {"points": _List({"x": NUMBER, "y": NUMBER})},
                "dimensions": POINT,
            },
        }
    ),
}

NEEDS: dict[str, Mapping[str, Any]] = {
    "sensor_msgs/msg/PointCloud2": {
        "header": HEADER,
        **dict.fromkeys(("height", "width", "is_bigendian", "point_step", "row_step"), WHOLE),
        "fields": _List({"name": TEXT, **dict.fromkeys(("offset", "datatype", "count"), WHOLE)}),
        "data": BYTES,
    },
    "sensor_msgs/msg/Image": IMAGE,
    "sensor_msgs/msg/CompressedImage": {"header": HEADER, "format": TEXT, "data": BYTES},
    "sensor_msgs/msg/CameraInfo": {
        "header": HEADER,
        **dict.fromkeys(("height", "width", "binning_x", "binning_y"), WHOLE),
        "distortion_model": TEXT,
        "d|D": _Values("float64[]", _FLOATS),
        "k|K": _Values("float64[9]", _FLOATS, 9),
        "r|R": _Values("float64[9]", _FLOATS, 9),
        "p|P": _Values("float64[12]", _FLOATS, 12),
        "roi": dict.fromkeys(("x_offset", "y_offset", "height", "width"), WHOLE),
    },
    "tf/msg/tfMessage": TRANSFORMS,
    "tf2_msgs/msg/TFMessage": TRANSFORMS,
    "nav_msgs/msg/Odometry": {
        "header": HEADER,
        "child_frame_id": TEXT,
        "pose": {"pose": {"position": POINT, "orientation": QUATERNION}},
    },
    "diagnostic_msgs/msg/DiagnosticArray": {
        "header": HEADER,
        "status": _List({"name": TEXT, "values": _List({"key": TEXT, "value": TEXT})}),
    },
    "vision_msgs/msg/Detection2DArray": {
        "header": HEADER,
        "detections": _List(
            {"results": _List(HYPOTHESIS), "bbox": {"center": CENTER, "size_x": NUMBER, "size_y": NUMBER}}
        ),
    },
    "vision_msgs/msg/Detection3DArray": {
        "header": HEADER,
        "detections": _List(
            {
                "results": _List(POSED_HYPOTHESIS),
                "bbox": {"center": {"position": POINT, "orientation": QUATERNION}, "size": POINT},
            }
        ),
    },
    "autoware_perception_msgs/msg/DetectedObjects": DETECTED_OBJECTS,
    "autoware_auto_perception_msgs/msg/DetectedObjects": DETECTED_OBJECTS,
    "foxglove_msgs/msg/CompressedVideo": {"timestamp": TIME, "frame_id": TEXT, "data": BYTES, "format": TEXT},
    "ffmpeg_image_transport_msgs/msg/FFMPEGPacket": {
        "header": HEADER,
        "encoding": TEXT,
        "flags": WHOLE,
        "data": BYTES,
    },
}
"""By type."""

EXACT = frozenset({"sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage", "velodyne_msgs/msg/VelodyneScan"})
"""Types of which bytes are passed on or read in place, so that they must lie as in the type of that name."""


def layout_fault(msgtype: str, types: Typesdict, known: Typesdict) -> str:
    """What lidcam needs of a type and its definition does not have; empty if it has all, or the type is not read.

    Args:
        msgtype: Name of the type.
        types: The recorded definitions of the type and those that it contains.
        known: The definitions of the ROS release.
    """
    needs = NEEDS.get(msgtype)
    if needs is not None and (fault := _message_fault(msgtype, needs, types, "")):
        return fault
    if needs is not None and "header" in needs and (fault := _header_fault(msgtype, types, known)):
        return fault
    if msgtype in EXACT and not _is_same(msgtype, types, known):
        return f"its fields do not lie as in ROS's {msgtype}"
    return ""


def _message_fault(msgtype: str, needs: Mapping[str, Any], types: Typesdict, path: str) -> str:
    found = dict(types[msgtype][1])
    for names, need in needs.items():
        name = next((name for name in names.split("|") if name in found), "")
        place = f"{path}{names.split('|')[0]}"
        if not name:
            return f"it has no field {place}"
        if fault := _fault(found[name], need, types, place):
            return fault
    return ""


def _fault(field: Any, need: _Need, types: Typesdict, place: str) -> str:
    node, detail = field
    match need:
        case _Value():
            fits, words = node == Nodetype.BASE and detail[0] in need.bases, need.words
        case _Values():
            fits = node in _LISTS and detail[0][0] == Nodetype.BASE and detail[0][1][0] in need.bases
            fits = fits and (not need.length or (node == Nodetype.ARRAY and detail[1] == need.length))
            words = need.words
        case _List():
            if node in _LISTS:
                return _fault(detail[0], need.item, types, f"{place}[]")
            fits, words = False, "a list"
        case _Either():
            faults = [_fault(field, one, types, place) for one in need.needs]
            return "" if not all(faults) else faults[0]
        case Mapping():
            if node == Nodetype.NAME:
                return _message_fault(str(detail), need, types, f"{place}.")
            fits, words = False, "a message"
    return "" if fits else f"its field {place} is {_words(field)}, expected {words}"


def _header_fault(msgtype: str, types: Typesdict, known: Typesdict) -> str:
    """Whether the stamp lies where `peek_stamp_ns` reads it, before a message is decoded."""
    name, field = types[msgtype][1][0]
    header = "std_msgs/msg/Header"
    if name == "header" and field == (Nodetype.NAME, header) and _is_same(header, types, known):
        return ""
    return f"it does not begin with a {header}"


def _is_same(msgtype: str, types: Typesdict, known: Typesdict) -> bool:
    """Whether two definitions have the same fields, and their fields' types the same, too."""
    if types[msgtype][1] != known[msgtype][1]:
        return False
    inner: list[Any] = [detail[0] if node in _LISTS else (node, detail) for _, (node, detail) in types[msgtype][1]]
    return all(_is_same(str(detail), types, known) for node, detail in inner if node == Nodetype.NAME)


def _words(field: Any) -> str:
    node, detail = field
    if node in _LISTS:
        length = detail[1] if node == Nodetype.ARRAY else ""
        return f"{_words(detail[0])}[{length}]"
    return str(detail[0] if node == Nodetype.BASE else detail)
