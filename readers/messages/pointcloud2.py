"""Decodes sensor_msgs/PointCloud2 of any field layout.

Only the name says what a field means, and drivers do not agree on names. Letter case is ignored; of several fields with
one meaning, the first in `INTENSITY_FIELDS` or `RING_FIELDS`, or the first plausible one in `TIME_FIELDS`, is used.
Other fields are ignored.

| field | datatype | meaning | written by |
| --- | --- | --- | --- |
| time | float32 | seconds from the header stamp; negative where that is the last packet's time | velodyne_pointcloud |
| time | float32 | microseconds from the header stamp | data sets that FAST-LIO was tested with (NCLT, UTBM) |
| t | uint32 | nanoseconds from the header stamp | ouster_ros |
| time_stamp | uint32 | nanoseconds from the header stamp | Nebula, PointXYZIRCAEDT |
| offset_time | any | nanoseconds from the header stamp | clouds made of Livox CustomMsg |
| timestamp | float64 | seconds of the header's clock | hesai_ros_driver, rslidar_sdk |
| time_stamp | float64 | seconds of the header's clock | Nebula, PointXYZIRADT |
| timestamp | float64, int64, uint64 | nanoseconds of the header's clock | livox_ros_driver2 |

Each interpretation is tried in turn until one puts every point within two seconds of the header stamp. Integers:
nanoseconds from the stamp, then of its clock. float32: seconds from the stamp. float64 with "stamp" in its name:
seconds of the header's clock, then nanoseconds of it, then seconds from the stamp; under other names seconds from the
stamp come first; then floats are taken in the unit (ms, us, ns) in which they begin or end near the stamp and last as
long as a sweep. If none fits (two clocks), the cloud has no times; nor if all are zero, which some drivers write to
fields that they do not support (ros-drivers/velodyne#402). Microseconds in an integer field cannot be distinguished
from nanoseconds; no driver in the table writes them.
"""

import logging
from collections.abc import Iterator, Mapping
from functools import lru_cache
from typing import Any

import numpy as np

from lidcam.pipeline.core.arrays import F32, I32, U16, Array, Bools
from lidcam.pipeline.core.clouds import PointCloud
from lidcam.pipeline.core.errors import MessageError
from lidcam.pipeline.core.messages import RawMessage
from lidcam.pipeline.core.ros.messages import POINT_FIELD_DATATYPES
from lidcam.pipeline.core.settings.recording import DEFAULT_LIMITS, RecordingLimits
from lidcam.readers.messages.decoding import decoder
from lidcam.readers.messages.deserialize import deserialize_as
from lidcam.readers.messages.tf import clean_frame

logger = logging.getLogger(__name__)

TIME_FIELDS = (
    "offset_time",
    "time_offset_ns",
    "point_time_offset",
    "time_offset",
    "t",
    "time",
    "timestamp",
    "time_stamp",
    "stamp",
    "stamps",
)

MAX_OFFSET_NS = 2_000_000_000
"""No sweep lasts longer; int32 nanoseconds end at 2.147 s."""

MAX_M = 1e8
"""Largest coordinate, metres: some drivers write points without a return as infinite or 3.4e38."""

MIN_SWEEP_NS = 5_000_000
"""Shortest sweep by which the unit of times is recognised: 200 turns a second."""

_NS_PER_S = 1_000_000_000


def point_time_offsets(fields: Mapping[str, Array], stamp_ns: int, *, topic: str) -> I32 | None:
    """(N,) time of each point minus the header stamp `stamp_ns`, nanoseconds; None if there is no usable field.

    `fields` has arrays (N,) by name in lower case, of which those in `TIME_FIELDS` count. The log names, once,
    the `topic` whose times are not plausible.
    """
    for name in TIME_FIELDS:
        values = fields.get(name)
        if values is None or not values.any():
            continue
        with np.errstate(over="ignore", invalid="ignore"):  # wrong interpretations may overflow
            for offset_ns in _readings(name, values, stamp_ns):
                if bool(((offset_ns >= -MAX_OFFSET_NS) & (offset_ns <= MAX_OFFSET_NS)).all()):
                    return np.rint(offset_ns).astype(np.int32)
        _log_unusable(topic, name)
    return None


def _readings(name: str, values: Array, stamp_ns: int) -> Iterator[Array]:
    """The possible meanings of the values as nanoseconds after `stamp_ns`, the most likely first."""
    if values.dtype.kind in "iu":
        integers = values.astype(np.int64)
        yield integers
        if values.dtype.itemsize == 8:
            yield integers - stamp_ns
        return
    numbers = values.astype(np.float64)
    if name in {"offset_time", "time_offset_ns"}:
        yield numbers
        return
    if "stamp" not in name or values.dtype.itemsize == 4:
        yield numbers * 1e9
    if values.dtype.itemsize == 8:
        # Subtract the large parts before scaling, to lose no digits.
        stamp_s, beyond_ns = divmod(stamp_ns, _NS_PER_S)
        yield (numbers - stamp_s) * 1e9 - beyond_ns
        base = float(stamp_ns)
        yield (numbers - base) + (int(base) - stamp_ns)
        if "stamp" in name:
            yield numbers * 1e9
    span = np.ptp(numbers)
    if 2 * span >= np.abs(numbers).max():
        yield from (numbers * unit_ns for unit_ns in (1e6, 1e3, 1.0) if span * unit_ns >= MIN_SWEEP_NS)


@lru_cache(maxsize=256)  # once per topic is enough
def _log_unusable(topic: str, name: str) -> None:
    logger.warning(
        "%s: field %r does not hold times within %d s of the header stamp; the cloud has no times of points",
        topic,
        name,
        MAX_OFFSET_NS // _NS_PER_S,
    )


INTENSITY_FIELDS = ("intensity", "intensities", "i", "reflectivity", "reflectance", "signal", "remission", "amplitude")
CALIBRATED_FIELD = "reflectivity"
"""Calibrated intensities of an Ouster, whole numbers up to 255 since firmware 2.1. Its `intensity` is the signal, which
falls with the range and has no largest value (ouster-lidar/ouster-ros#408)."""

RING_FIELDS = ("ring", "channel", "laser_id", "laser", "line", "beam", "row")

_USED_FIELDS = frozenset(("x", "y", "z", *INTENSITY_FIELDS, *RING_FIELDS, *TIME_FIELDS))

# sensor_msgs/PointField; PCL wrote 9 to 11 before ROS named them (ros2/common_interfaces#301).
_DTYPES = {number: dtype for dtype, number in POINT_FIELD_DATATYPES.items()} | {9: "i8", 10: "u8", 11: "u1"}


@decoder
def decode_pointcloud2(
    message: RawMessage, *, limits: RecordingLimits = DEFAULT_LIMITS, others: int = 0, calibrated: bool = True
) -> PointCloud:
    """The points of a message in recorded order (organised clouds row by row), without points that have no place.

    Coordinates become float32 metres: steps of 8 micrometres at 100 m, but of half a metre at 5 000 km (clouds in UTM
    coordinates).

    Returns:
        The cloud at the message's stamp. Points with a coordinate that is NaN or beyond `MAX_M` are removed and counted
        in `nan_dropped`. Intensities that are not finite are 0, as where there are none; `calibrated` ones are those of
        `CALIBRATED_FIELD` where they are known, else nodes hand on the others. Rings are clipped to 0 to 65535.
    """
    cloud = deserialize_as(message, "sensor_msgs/msg/PointCloud2", limits=limits)
    check_points(int(cloud.width), message.topic, limits, others, rows=int(cloud.height))
    return cloud_of_fields(message, cloud, calibrated=calibrated)


def check_points(width: int, topic: str, limits: RecordingLimits, others: int, *, rows: int = 1) -> None:
    """Check the number of points of a cloud beside the `others` of its frame."""
    shape, count = f"{rows} x {width}", rows * width
    if count > limits.max_points:
        raise MessageError(f"{topic}: {shape} points, expected at most {limits.max_points}: raise limit_scale")
    if others + count > limits.max_frame_points:
        raise MessageError(
            f"{topic}: {shape} points, and {others} in other clouds of the frame, expected at most "
            f"{limits.max_frame_points} in all: raise limit_scale"
        )


def cloud_of_fields(message: RawMessage, cloud: Any, *, calibrated: bool = True) -> PointCloud:
    """The cloud of a message from a PointCloud2, whose points were counted; see `decode_pointcloud2`."""
    columns = _columns(cloud, int(cloud.height), int(cloud.width), message.topic)
    return cloud_of_columns(message, clean_frame(cloud.header.frame_id), columns, calibrated=calibrated)


def cloud_of_columns(
    message: RawMessage, frame_id: str, columns: dict[str, Array], *, calibrated: bool = True
) -> PointCloud:
    """The cloud of a message from columns (height, width) by name in lower case; other names are ignored."""
    count = columns["x"].size
    xyz, keep = _placed_points([columns.pop(axis) for axis in "xyz"])
    fields = {name: column.reshape(-1)[keep] for name, column in columns.items()}
    intensity = next((fields[name] for name in INTENSITY_FIELDS if name in fields), None)
    reflectivity = fields.get(CALIBRATED_FIELD) if calibrated else None
    if reflectivity is not None and reflectivity.dtype.kind == "u" and 0 < reflectivity.max(initial=0) <= 255:
        intensity = reflectivity
    ring = next((fields[name] for name in RING_FIELDS if name in fields), None)
    time_offset_ns = point_time_offsets(fields, message.stamp_ns, topic=message.topic)
    n = len(xyz)
    return PointCloud(
        stamp_ns=message.stamp_ns,
        frame_id=frame_id,
        xyz=xyz,
        intensity=np.zeros(n, np.float32) if intensity is None else _as_intensity(intensity),
        ring=np.zeros(n, np.uint16) if ring is None else _as_uint16(ring),
        time_offset_ns=np.zeros(n, np.int32) if time_offset_ns is None else time_offset_ns,
        has_time=time_offset_ns is not None,
        nan_dropped=count - n,
    )


def _columns(cloud: Any, height: int, width: int, topic: str) -> dict[str, Array]:
    """Views (height, width) into the data, one for each field with a known meaning, by name in lower case."""
    if height * width == 0:  # empty clouds often come without any fields
        return {axis: np.zeros((0, 0), np.float32) for axis in "xyz"}
    fields = {
        field.name.lower(): field for field in reversed(cloud.fields)
    }  # reversed: of equal names the first is used
    if not {"x", "y", "z"} <= fields.keys():
        names = ", ".join(field.name for field in cloud.fields) or "none"
        raise MessageError(f"{topic}: expected the fields x, y and z, found {names}")
    point_step = int(cloud.point_step)
    # A single row does not need its step, nor do rows without gaps: some writers leave it zero, and
    # sensor_msgs::PointCloud2Modifier sets it to the size of all rows (ros2/common_interfaces#320).
    is_packed = height == 1 or not cloud.row_step or len(cloud.data) == height * width * point_step
    row_step = width * point_step if is_packed else int(cloud.row_step)
    if row_step < width * point_step or (height - 1) * row_step + width * point_step > len(cloud.data):
        raise MessageError(
            f"{topic}: {height} x {width} points of {point_step} bytes in rows of {row_step} bytes "
            f"do not fit {len(cloud.data)} bytes of data"
        )
    data = cloud.data
    if data.ctypes.data % 8 and point_step % 4 == 0:
        data = data.copy()  # numpy is seven times slower on unaligned numbers
    order = ">" if cloud.is_bigendian else "<"
    columns = {}
    for name, field in fields.items():
        used = name in _USED_FIELDS
        if field.datatype not in _DTYPES:
            if used:
                raise MessageError(f"{topic}: field {field.name} has datatype {field.datatype}, expected 1 to 11")
            continue
        dtype = np.dtype(order + _DTYPES[field.datatype])
        end = int(field.offset) + dtype.itemsize * max(int(field.count), 1)
        if end > point_step:
            raise MessageError(f"{topic}: field {field.name} ends at byte {end} of a point of {point_step} bytes")
        if used:  # the first element of a field with several
            columns[name] = np.ndarray((height, width), dtype, data, field.offset, (row_step, point_step))
    return columns


def _placed_points(axes: list[Array]) -> tuple[F32, slice | Bools]:
    """Points (N, 3) within `MAX_M` of three columns (height, width), and their rows in the flattened columns."""
    grid = np.empty((*axes[0].shape, 3), np.float32)
    with np.errstate(over="ignore", invalid="ignore"):  # float64 beyond float32 becomes infinite
        for index, axis in enumerate(axes):
            grid[..., index] = axis
    xyz = grid.reshape(-1, 3)
    placed = np.abs(xyz) <= MAX_M
    if placed.all():
        return xyz, slice(None)
    keep = placed[:, 0] & placed[:, 1] & placed[:, 2]
    return xyz[keep], keep


def _as_intensity(values: Array) -> F32:
    with np.errstate(over="ignore", invalid="ignore"):
        return np.nan_to_num(np.array(values, np.float32), copy=False, posinf=0.0, neginf=0.0)


def _as_uint16(values: Array) -> U16:
    if values.dtype.kind == "u" and values.dtype.itemsize <= 2:
        return np.array(values, np.uint16)
    return np.asarray(np.clip(np.nan_to_num(values), 0, 65535), np.uint16)
