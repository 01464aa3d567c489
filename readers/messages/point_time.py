"""The measurement time of each point of a cloud: units and origins of the drivers' time fields.

Drivers agree on neither name nor unit. Letter case is ignored; of several fields in `TIME_FIELDS`, the first plausible
one is used.

| field | datatype | meaning | written by |
| --- | --- | --- | --- |
| time | float32 | seconds from the header stamp; negative where that is the last packet's time | velodyne_pointcloud |
| t | uint32 | nanoseconds from the header stamp | ouster_ros |
| time_stamp | uint32 | nanoseconds from the header stamp | Nebula, PointXYZIRCAEDT |
| offset_time | any | nanoseconds from the header stamp | clouds made of Livox CustomMsg |
| timestamp | float64 | seconds of the header's clock | hesai_ros_driver, rslidar_sdk |
| time_stamp | float64 | seconds of the header's clock | Nebula, PointXYZIRADT |
| timestamp | float64, int64, uint64 | nanoseconds of the header's clock | livox_ros_driver2 |

Each interpretation is tried in turn until one puts every point within two seconds of the header stamp. Integers:
nanoseconds from the stamp, then of its clock. float32: seconds from the stamp. float64 with "stamp" in its name:
seconds of the header's clock, then nanoseconds of it, then seconds from the stamp; under other names seconds from the
stamp come first. If none fits (two clocks, another unit), the cloud has no times; nor if all are zero, which some
drivers write to fields that they do not support (ros-drivers/velodyne#402). Microseconds in an integer field cannot be
distinguished from nanoseconds; no driver in the table writes them.
"""

import logging
from collections.abc import Iterator, Mapping
from functools import lru_cache

import numpy as np

from lidcam.pipeline.core.arrays import I32, Array

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

_NS_PER_S = 1_000_000_000


def point_time_offsets(fields: Mapping[str, Array], stamp_ns: int, *, topic: str) -> I32 | None:
    """Time of each point minus `stamp_ns` in nanoseconds, (N,).

    Args:
        fields: Array (N,) by field name in lower case; fields not in `TIME_FIELDS` are ignored.
        stamp_ns: The message's header stamp.
        topic: Named in the log, once, if a time field is not plausible.

    Returns:
        None if there is no usable field.
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


@lru_cache(maxsize=256)  # once per topic is enough
def _log_unusable(topic: str, name: str) -> None:
    logger.warning(
        "%s: field %r does not hold times within %d s of the header stamp; the cloud has no times of points",
        topic,
        name,
        MAX_OFFSET_NS // _NS_PER_S,
    )
