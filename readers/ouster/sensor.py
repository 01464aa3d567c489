"""One Ouster lidar, by the JSON that it describes itself with, and Ouster's own library, which knows its packets.

`ouster-sdk` requires an old version of rosbags, beside which lidcam cannot be installed, but what is used of it runs
with the new one: `pip install --no-deps ouster-sdk` is the way to have both.
"""

import sqlite3
from dataclasses import dataclass
from functools import cached_property, lru_cache
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from types import ModuleType
from typing import Any

import numpy as np

from lidcam.pipeline.core.arrays import F32, I64
from lidcam.pipeline.core.errors import MessageError
from lidcam.pipeline.core.messages import MAX_TIME_NS
from lidcam.pipeline.core.text import one_line

MAX_METADATA_CHARACTERS = 1 << 18

PTP = "TIME_FROM_PTP_1588"
TAI_NS = 37_000_000_000
"""International atomic time minus UTC: what ouster-ros takes off the stamps of sensors that are synchronised by PTP."""

SET_CLOCK_NS = 946_684_800 * 10**9
"""The year 2000: a clock before it was never set, and counts from when the sensor was switched on."""


def missing_sdk() -> str:
    """Why packets of an Ouster cannot be decoded on this machine and what to do; empty if they can."""
    try:
        found = version("ouster-sdk")
    except PackageNotFoundError:
        found = "0"
    if not found.startswith("0"):
        return ""
    return "packets of an Ouster, which need its library: pip install --no-deps 'ouster-sdk>=1.0'"


@lru_cache(maxsize=1)
def sdk() -> ModuleType:
    """`ouster.sdk.core`, without what it changes elsewhere: its import puts another `connect` into sqlite3."""
    connect = sqlite3.connect
    try:
        core = import_module("ouster.sdk.core")
    finally:
        sqlite3.connect = connect
    core.init_logger("error")
    return core


@lru_cache(maxsize=64)
def sensor_of(metadata: str) -> "OusterSensor":
    """The sensor that describes itself so; raises MessageError if it is no description of an Ouster."""
    if len(metadata) > MAX_METADATA_CHARACTERS:
        raise MessageError(f"expected the JSON of an Ouster, found {len(metadata)} characters")
    try:
        info = sdk().SensorInfo(metadata)
        packets = sdk().PacketFormat(info)
        columns, rows = int(info.format.columns_per_frame), int(info.format.pixels_per_column)
        return OusterSensor(metadata, info, packets, columns, rows, 1e9 / (columns * int(info.format.fps)))
    except (RuntimeError, ValueError, LookupError, ArithmeticError) as err:
        reason = one_line(err, max_characters=200)
        raise MessageError(f"expected the JSON of an Ouster, found {len(metadata)} characters ({reason})") from err


@dataclass(frozen=True, eq=False)
class OusterSensor:
    """Beams, columns and packet format of one lidar."""

    metadata: str  # Its JSON
    info: Any  # `SensorInfo`
    packets: Any  # `PacketFormat`
    columns: int  # Measurements in a turn
    rows: int  # Lasers
    column_ns: float  # Time from one measurement to the next

    @property
    def packet_bytes(self) -> int:
        """Size of its packets."""
        return int(self.packets.lidar_packet_size)

    def frame_number(self, packet: bytes) -> int:
        """The number of the turn that a packet belongs to."""
        return int(self.packets.frame_id(packet))

    def sends(self, packet: bytes) -> bool:
        """Whether a packet is this sensor's, by its size and, where it has one, its serial number."""
        one = sdk().LidarPacket(self.packets)
        one.buf[:] = np.frombuffer(packet, np.uint8)
        return bool(one.validate(self.info) == sdk().PacketValidationFailure.NONE)

    def is_later(self, number: int, before: int) -> bool:
        """Whether a turn came after another one; numbers begin anew."""
        numbers = int(self.packets.max_frame_id) + 1
        return 0 < (number - before) % numbers < numbers // 2

    def times_ns(self, packet: bytes | memoryview, received_ns: int) -> tuple[int, int]:
        """The stamp of a packet's turn, and the time of its first column by the sensor's clock, counted back to it.

        The stamp is by the sensor's clock if that was set, else by when the packet was received: ouster-ros has a
        parameter for either. It takes 37 s off times by PTP, which is right where the clock has atomic time; here that
        decides which comes nearer to the time of recording.

        Raises:
            MessageError: none of the packet's columns is valid, or their times are none.
        """
        core, buffer = sdk(), np.frombuffer(packet, np.uint8)
        status, numbers, times = (
            np.asarray(self.packets.packet_header(header, buffer))
            for header in (core.ColHeader.STATUS, core.ColHeader.MEASUREMENT_ID, core.ColHeader.TIMESTAMP)
        )
        valid = np.flatnonzero(status & 1)
        if not len(valid):
            raise MessageError("a packet without a valid column")
        since_ns = round(int(numbers[valid[0]]) * self.column_ns)
        begin_ns = int(times[valid[0]]) - since_ns
        if begin_ns > MAX_TIME_NS:
            raise MessageError(f"a packet whose clock says {begin_ns} ns")
        if begin_ns < SET_CLOCK_NS:
            return received_ns - since_ns, begin_ns
        is_ptp = getattr(self.info.config.timestamp_mode, "name", "") == PTP
        times_ns = (begin_ns, begin_ns - TAI_NS) if is_ptp else (begin_ns,)
        return min(times_ns, key=lambda time_ns: abs(time_ns - received_ns)), begin_ns

    @cached_property
    def _lut(self) -> Any:
        """Makes points of ranges, in the lidar's own frame."""
        info = sdk().SensorInfo(self.metadata)
        info.lidar_to_sensor_transform = np.eye(4)
        return sdk().XYZLut(info)

    def points(self, ranges: Any) -> F32:
        """(rows, columns, 3) float32 metres in the lidar's own frame, of ranges (rows, columns); columns in time."""
        return np.asarray(self._lut(ranges), np.float32)

    @cached_property
    def order(self) -> I64:
        """(rows * columns,) places of the points, as ouster-ros orders them: row by row, by azimuth."""
        places = np.arange(self.rows * self.columns, dtype=np.int64).reshape(self.rows, self.columns)
        return np.asarray(sdk().destagger(self.info, places)).reshape(-1)
