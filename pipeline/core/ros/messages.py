"""Builds ROS messages with the types of rosbags, and serialises them."""

from collections.abc import Iterable, Mapping
from functools import cache, cached_property
from itertools import repeat, starmap
from keyword import iskeyword
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys.store import Typestore

from lidcam.pipeline.core.arrays import F64, U8, Array
from lidcam.pipeline.core.geometry.transform import Transform
from lidcam.pipeline.core.ros.typestores import RosVersion, message_types
from lidcam.pipeline.native.kernels import ONE, SEQUENCE, CdrType, cdr

POINT_FIELD_DATATYPES = {"i1": 1, "u1": 2, "i2": 3, "u2": 4, "i4": 5, "u4": 6, "f4": 7, "f8": 8}
"""sensor_msgs/PointField's number for each numpy type."""

_NO_ROTATION = (0.0, 0.0, 0.0, 1.0)


class RosMessages:
    """Builds the messages of one ROS version: 1 for Noetic, 2 for Humble.

    `start_ns` is added to every stamp: the origin of the methods' stamps, in ns since 1970.
    """

    def __init__(self, ros_version: RosVersion, start_ns: int = 0) -> None:
        self.ros_version, self.start_ns = ros_version, start_ns
        self._empty: dict[str, Mapping[str, Any]] = {}

    @cached_property
    def _types(self) -> Typestore:
        return message_types(self.ros_version)

    def new(self, msgtype: str, *values: Any, **fields: Any) -> Any:
        """A message of any type, from its fields in order or by name."""
        return self._types.types[msgtype](*values, **fields)

    def rows(self, msgtype: str, count: int, **columns: Any) -> list[Any]:
        """Messages of one type, from columns by the name of the field; zero or empty where left out.

        A column is a list or an array (N,), (N, K) of arrays, of N = `count` values; anything else is the value of all.

        Raises:
            LookupError: there is no such field.
            ValueError: a column has more or fewer values.
        """
        empty = self._empty_fields(msgtype).items()
        each = [_values(columns.pop(name), count) if name in columns else repeat(zero, count) for name, zero in empty]
        if columns:
            raise LookupError(f"{msgtype} has no {', '.join(sorted(columns))}")
        return list(starmap(self._types.types[msgtype], zip(*each, strict=True)))

    def rows_of_numbers(self, msgtype: str, numbers: Array) -> list[Any]:
        """Messages of K numbers and nothing else, as points are, from an array (N, K)."""
        return list(starmap(self._types.types[msgtype], numbers.tolist()))

    def _empty_fields(self, msgtype: str) -> Mapping[str, Any]:
        """The values of fields that are left out: of numbers 0, of lists none; all messages share them."""
        if msgtype not in self._empty:
            fields = self._types.fielddefs[msgtype][1]
            self._empty[msgtype] = {name: self._empty_value(kind) for name, kind in fields}
        return self._empty[msgtype]

    def _empty_value(self, kind: Any) -> Any:
        node, detail = kind
        if node == Nodetype.NAME:
            return self.new(detail, *self._empty_fields(detail).values())
        if node == Nodetype.BASE:
            return "" if detail[0] == "string" else 0
        (item, what), length = detail
        return np.zeros(length, what[0]) if item == Nodetype.BASE and what[0] != "string" else []

    def serialize(self, message: Any) -> bytes:
        """The bytes of a message: ROS 1, or little-endian CDR.

        Raises:
            ValueError: a number does not fit its field, or an array has another length; of ROS 1, struct.error.
            TypeError: a field holds something else; of ROS 1, AttributeError.
        """
        if self.ros_version == 1:
            return bytes(self._types.serialize_ros1(message, message.__msgtype__))
        return cdr(cdr_type(self._types, message.__msgtype__), message)

    def deserialize(self, data: bytes | memoryview, msgtype: str) -> Any:
        """The message of bytes that `serialize` made."""
        read = self._types.deserialize_ros1 if self.ros_version == 1 else self._types.deserialize_cdr
        return read(data, msgtype)

    def definition(self, msgtype: str) -> str:
        """A type's definition with those of all types that it contains, as MCAP's `ros1msg` and `ros2msg`."""
        return _definition(self.ros_version, msgtype)

    def time(self, stamp_ns: int) -> Any:
        """builtin_interfaces/Time."""
        return self.new("builtin_interfaces/msg/Time", *divmod(self.start_ns + stamp_ns, 10**9))

    def header(self, stamp_ns: int, frame_id: str) -> Any:
        """std_msgs/Header; ROS 1's `seq` is 0, as in messages that a node has not published yet."""
        seq = {"seq": 0} if self.ros_version == 1 else {}
        return self.new("std_msgs/msg/Header", stamp=self.time(stamp_ns), frame_id=frame_id, **seq)

    def vector(self, x: float, y: float, z: float) -> Any:
        """geometry_msgs/Vector3."""
        return self.new("geometry_msgs/msg/Vector3", x, y, z)

    def pose(self, position: Iterable[float], quaternion_xyzw: Iterable[float] = _NO_ROTATION) -> Any:
        """geometry_msgs/Pose."""
        point = self.new("geometry_msgs/msg/Point", *position)
        return self.new("geometry_msgs/msg/Pose", point, self.new("geometry_msgs/msg/Quaternion", *quaternion_xyzw))

    def pose_with_covariance(self, pose: Any, covariance: F64 | None = None) -> Any:
        """geometry_msgs/PoseWithCovariance; the covariance (36,) is zero unless given."""
        covariance = np.zeros(36) if covariance is None else covariance
        return self.new("geometry_msgs/msg/PoseWithCovariance", pose, covariance)

    def transform_stamped(
        self, stamp_ns: int, parent: str, child: str, translation: Iterable[float], quaternion_xyzw: Iterable[float]
    ) -> Any:
        """geometry_msgs/TransformStamped."""
        rotation = self.new("geometry_msgs/msg/Quaternion", *quaternion_xyzw)
        transform = self.new("geometry_msgs/msg/Transform", self.vector(*translation), rotation)
        return self.new("geometry_msgs/msg/TransformStamped", self.header(stamp_ns, parent), child, transform)

    def transforms(self, stamp_ns: int, transforms: Iterable[Transform]) -> Any:
        """tf2_msgs/TFMessage."""
        stamped = [
            self.transform_stamped(stamp_ns, one.dst, one.src, one.translation.tolist(), one.quaternion_xyzw.tolist())
            for one in transforms
        ]
        return self.new("tf2_msgs/msg/TFMessage", stamped)

    def camera_info(
        self,
        stamp_ns: int,
        frame_id: str,
        *,
        width: int,
        height: int,
        distortion_model: str,
        d: F64,
        k: F64,
        r: F64 | None = None,
        p: F64 | None = None,
    ) -> Any:
        """sensor_msgs/CameraInfo without region of interest or binning.

        Coefficients `d` (K,) and, row by row, matrices `k` (9,), `r` (9,) and `p` (12,) are float64. Without `r` there
        is no rectification; without `p` it is [K | 0], for images that are not rectified.
        """
        matrices = {
            "d": d,
            "k": k,
            "r": np.eye(3).reshape(9) if r is None else r,
            "p": np.c_[k.reshape(3, 3), np.zeros(3)].reshape(12) if p is None else p,
        }
        return self.new(
            "sensor_msgs/msg/CameraInfo",
            header=self.header(stamp_ns, frame_id),
            height=height,
            width=width,
            distortion_model=distortion_model,
            binning_x=0,
            binning_y=0,
            roi=self.new("sensor_msgs/msg/RegionOfInterest", 0, 0, 0, 0, False),
            **{name.upper() if self.ros_version == 1 else name: matrix for name, matrix in matrices.items()},
        )

    def point_cloud2(
        self,
        stamp_ns: int,
        frame_id: str,
        fields: Iterable[tuple[str, int, int]],
        data: U8,
        *,
        point_step: int,
        is_dense: bool = True,
    ) -> Any:
        """sensor_msgs/PointCloud2 of one row, little endian; `fields` are name, offset and datatype."""
        width = len(data) // point_step if point_step else 0
        return self.new(
            "sensor_msgs/msg/PointCloud2",
            header=self.header(stamp_ns, frame_id),
            height=1,
            width=width,
            fields=[self.new("sensor_msgs/msg/PointField", *field, 1) for field in fields],
            is_bigendian=False,
            point_step=point_step,
            row_step=point_step * width,
            data=data,
            is_dense=is_dense,
        )

    def cloud(self, stamp_ns: int, frame_id: str, columns: Mapping[str, Array]) -> Any:
        """sensor_msgs/PointCloud2 of finite points: arrays (N,) by field name, laid side by side in their order."""
        layout = np.dtype([(name, values.dtype.newbyteorder("<")) for name, values in columns.items()])
        points = np.empty(len(next(iter(columns.values()))), layout)
        for name, values in columns.items():
            points[name] = values
        offsets = [layout.fields[name][1] for name in columns] if layout.fields else []
        datatypes = [POINT_FIELD_DATATYPES[values.dtype.str[1:]] for values in columns.values()]
        fields = zip(columns, offsets, datatypes, strict=True)
        return self.point_cloud2(stamp_ns, frame_id, fields, points.view(np.uint8), point_step=layout.itemsize)

    def image(
        self, stamp_ns: int, frame_id: str, *, height: int, width: int, encoding: str, step: int, data: U8
    ) -> Any:
        """sensor_msgs/Image, little endian: `data` (height * step,)."""
        header = self.header(stamp_ns, frame_id)
        return self.new("sensor_msgs/msg/Image", header, height, width, encoding, 0, step, data)

    def compressed_image(self, stamp_ns: int, frame_id: str, format: str, data: U8) -> Any:
        """sensor_msgs/CompressedImage."""
        return self.new("sensor_msgs/msg/CompressedImage", self.header(stamp_ns, frame_id), format, data)


def _values(column: Any, count: int) -> Iterable[Any]:
    if isinstance(column, np.ndarray):
        return column.tolist() if column.ndim == 1 else list(column)
    return column if isinstance(column, list) else repeat(column, count)


@cache
def cdr_type(types: Typestore, msgtype: str) -> CdrType:
    """The fields of a type for `cdr`; rosbags would compile serialisers, 5 to 21 ms for each type."""
    fields = types.fielddefs[msgtype][1]
    return CdrType(msgtype, [(f"{name}_" if iskeyword(name) else name, *_held(types, kind)) for name, kind in fields])


def _held(types: Typestore, kind: Any) -> tuple[str | CdrType, int]:
    """Content and length of a field, for `CdrType`."""
    node, detail = kind
    if node == Nodetype.ARRAY:
        return _held(types, detail[0])[0], detail[1]
    if node == Nodetype.SEQUENCE:
        return _held(types, detail[0])[0], SEQUENCE
    return cdr_type(types, detail) if node == Nodetype.NAME else detail[0], ONE


@cache
def _definition(ros_version: RosVersion, msgtype: str) -> str:
    """See `RosMessages.definition`; rosbags spends a millisecond on each."""
    return message_types(ros_version).generate_msgdef(msgtype, ros_version=ros_version)[0]


ROS2 = RosMessages(2)
