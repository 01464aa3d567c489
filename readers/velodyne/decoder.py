"""Decodes velodyne_msgs/VelodyneScan, the packets as a Velodyne sends them.

Each block of a packet has one azimuth. The head turns on while the block's lasers fire: the rate is measured over the
packet (VLS-128: from packet to packet, as one packet may be one column), and every laser gets the azimuth and the time
of its own firing.

**Times.** Drivers disagree on the stamp in a scan's header: it is the first packet's or the last one's, by the host's
clock or by the sensor's (ros-drivers/velodyne#191, #218). A cloud keeps the header stamp, by which its scan was
synchronised, and `time_offset_ns` counts from it. The offsets come from the packets: their spacing from the sensor's
own microseconds, which do not jitter, aligned with the packets' stamps by the median of the differences. If the result
is more than two seconds from the header (two clocks), the last packet gets the header's stamp, as in ROS's driver.

Measured beside velodyne-decoder 3.1: its points agree within 2 mm and 0.01 degrees, since drivers round azimuths and
this one does not; it takes twice the time, needs two packets of a VLS-128 to start, and does not count what it drops.
"""

from pathlib import Path

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from lidcam.pipeline.core.arrays import F64, I64, Bools
from lidcam.pipeline.core.clouds import PointCloud
from lidcam.pipeline.core.errors import CalibrationError, ConfigError, MessageError
from lidcam.pipeline.core.messages import Drop, RawMessage
from lidcam.pipeline.core.settings.bounded_yaml import read_yaml
from lidcam.pipeline.core.settings.recording import VelodyneConfig
from lidcam.pipeline.core.settings.validation import checked
from lidcam.readers.messages.decoding import decoder
from lidcam.readers.messages.pointcloud2 import MAX_OFFSET_NS
from lidcam.readers.velodyne.models import (
    BLOCK_FLAGS,
    MODELS,
    VLS128_FIRST_FIRMWARE,
    LaserTable,
    RangeCorrections,
    VelodyneModel,
    built_in_table,
)
from lidcam.readers.velodyne.points import LAST, STRONGEST, UNKNOWN_RETURN, Beams, Layout, cloud_of
from lidcam.readers.velodyne.scan import VelodynePackets, parse_velodyne_scan


class _Laser(BaseModel):
    model_config = ConfigDict(extra="ignore", allow_inf_nan=False)

    laser_id: int
    rot_correction: float
    vert_correction: float
    dist_correction: float = 0.0
    dist_correction_x: float = 0.0
    dist_correction_y: float = 0.0
    vert_offset_correction: float = 0.0
    horiz_offset_correction: float = 0.0
    focal_distance: float = 0.0
    focal_slope: float = 0.0
    min_intensity: float = 0.0
    max_intensity: float = 255.0


class _File(BaseModel):
    model_config = ConfigDict(extra="ignore")

    lasers: list[_Laser] = Field(min_length=1)


def read_velodyne_calibration(path: Path, model: VelodyneModel) -> LaserTable:
    """The laser table of one unit; the file has radians and metres.

    `distance_resolution` is ignored: it is fixed by the model, and some files are wrong about it.
    """
    source = f"{path}: not a calibration of ROS's velodyne driver"
    lasers = sorted(checked(_File, read_yaml(path), source, CalibrationError).lasers, key=lambda laser: laser.laser_id)
    if [laser.laser_id for laser in lasers] != list(range(model.lasers)):
        raise CalibrationError(
            f"{path}: expected each laser_id of a {model.name} once, 0 to {model.lasers - 1}; "
            f"found {len(lasers)} lasers, {lasers[0].laser_id} to {lasers[-1].laser_id}"
        )

    def column(name: str) -> F64:
        return np.array([getattr(laser, name) for laser in lasers], np.float64)

    corrections = RangeCorrections(
        far_m=column("dist_correction"),
        near_x_m=column("dist_correction_x"),
        near_y_m=column("dist_correction_y"),
        horizontal_offset_m=column("horiz_offset_correction"),
        focal_distance=column("focal_distance"),
        focal_slope=column("focal_slope"),
        min_intensity=np.floor(column("min_intensity")),
        max_intensity=np.floor(column("max_intensity")),
    )
    return LaserTable(
        column("vert_correction"),
        column("rot_correction"),
        column("vert_offset_correction"),
        corrections if corrections.any_set else None,
    )


RETURN_MODES = {0x37: STRONGEST, 0x38: LAST}
DUAL = 0x39
HOUR_US = 3_600_000_000


class VelodyneDecoders:
    """One decoder per topic, made on first use."""

    def __init__(self, config: VelodyneConfig) -> None:
        self._config = config
        self._decoders: dict[str, VelodyneDecoder] = {}

    def __getitem__(self, topic: str) -> "VelodyneDecoder":
        """The decoder of a topic; raises as `VelodyneDecoder` does."""
        if topic not in self._decoders:
            self._decoders[topic] = VelodyneDecoder(self._config)
        return self._decoders[topic]


class VelodyneDecoder:
    """Decodes the scans of one lidar, by the settings and by what the packets say about the sensor.

    Raises ConfigError if the configured model needs a calibration file, or the file cannot be read, and
    CalibrationError if the file does not fit the model.
    """

    def __init__(self, settings: VelodyneConfig) -> None:
        self._calibration = settings.calibration
        self._model = None if settings.model == "auto" else MODELS[settings.model]
        self._beams: dict[tuple[VelodyneModel, Layout], Beams] = {}
        self._tables: dict[str, LaserTable] = {}
        if self._model is not None:
            self._table(self._model)

    def __call__(self, message: RawMessage) -> PointCloud:
        """The cloud of `decode`."""
        return self.decode(message)[0]

    @decoder
    def decode(self, message: RawMessage) -> tuple[PointCloud, tuple[Drop, ...]]:
        """The points of a scan in the order of the packets' bytes, and the packets that were not used.

        Returns the cloud at the message's stamp, with ring, time and return type of every point. The scan may have any
        length and begin anywhere. Two returns at equal distance become one point of type "both". Packets with blocks
        that are not marked as this model marks them are dropped.
        """
        packets = parse_velodyne_scan(message)
        drops = [_drop(message, "packets that cannot be decoded", fault, 1) for fault in message.defects]
        recorded = len(packets)
        if not recorded:
            nothing = PointCloud.zeros(
                stamp_ns=message.stamp_ns, frame_id=packets.frame_id, has_time=True, return_type=np.zeros(0, np.uint8)
            )
            return nothing, tuple(drops)
        marked = packets.fields["blocks"]["flag"][:, 0] == BLOCK_FLAGS[0]
        if marked.any():  # the others may hold anything in place of the model and the sensor's time
            packets = packets.select(marked)
        model = self._model_of(packets, message.topic)
        layout = _layout_of(packets, model)
        device_us = _device_us(packets)
        if model.name == "VLS-128" and len(device_us) > 1:  # lost packets do not affect the median
            column_us = np.median(np.diff(device_us)) / layout.columns
            model = VLS128_FIRST_FIRMWARE if 3 * column_us < 167 else model  # 160 us, later 173.3
        beams = self._beams_of(model, layout)
        known = _known_packets(packets, beams, message.topic)
        packets, device_us = packets.select(known), device_us[known]
        if foreign := recorded - len(packets):
            reason = f"packets with blocks that a {model.name} does not send"
            drops.append(_drop(message, reason, f"{foreign} of {recorded} packets of the scan", foreign))
        times_ns = _packet_times(packets, device_us, message)
        return cloud_of(packets, beams, device_us, times_ns, message.stamp_ns), tuple(drops)

    def _model_of(self, packets: VelodynePackets, topic: str) -> VelodyneModel:
        factory = packets.fields[["mode", "product"]]
        product = int(factory["product"][0])
        configured = self._model
        if configured is not None and configured.product is None:
            return configured
        if (factory != factory[0]).any():
            raise MessageError(
                f"{topic}: expected packets of one model and return mode, found several; an HDL-64E does not name "
                "itself: set velodyne.model and velodyne.calibration"
            )
        named = [model for model in MODELS.values() if model.product == product]
        if configured is not None:
            if named and configured not in named:
                raise MessageError(f"{topic}: velodyne.model says {configured.name}, the packets say {_names(named)}")
            return configured
        if len(named) != 1:
            found = _names(named) if named else f"product byte 0x{product:02x}"
            raise MessageError(f"{topic}: expected packets of one known model, found {found}; set velodyne.model")
        return named[0]

    def _beams_of(self, model: VelodyneModel, layout: Layout) -> Beams:
        key = (model, layout)
        if key not in self._beams:
            try:
                self._beams[key] = Beams(model, self._table(model), layout)
            except (CalibrationError, ConfigError) as err:
                raise MessageError(str(err)) from err
        return self._beams[key]

    def _table(self, model: VelodyneModel) -> LaserTable:
        if model.name not in self._tables:
            if self._calibration:
                table = read_velodyne_calibration(Path(self._calibration), model)
            elif model.product is None:
                raise ConfigError(
                    f"velodyne.model {model.name} needs velodyne.calibration, a file of ROS's velodyne driver: the "
                    "lasers of an HDL-64E differ from unit to unit"
                )
            else:
                table = built_in_table(model.name)
            self._tables[model.name] = table
        return self._tables[model.name]


def _names(models: list[VelodyneModel]) -> str:
    return " or ".join(model.name for model in models)


# --- contents of packets


def _layout_of(packets: VelodynePackets, model: VelodyneModel) -> Layout:
    """The layout of a scan's packets, by their return mode."""
    if model.product is None:  # the HDL-64E repeats a column's azimuth where it sends both returns, the strongest first
        azimuth = packets.fields["blocks"]["azimuth"]
        if np.count_nonzero(azimuth[:, 0] == azimuth[:, 2]) * 2 > len(azimuth):
            return Layout(model.columns_dual, model.banks, (STRONGEST, LAST), apart=model.banks)
        return Layout(model.columns, model.banks, (STRONGEST,))
    mode = int(packets.fields["mode"][0])
    if mode == DUAL:
        return Layout(model.columns_dual, model.banks, (LAST, STRONGEST))
    return Layout(model.columns, model.banks, (RETURN_MODES.get(mode, UNKNOWN_RETURN),))


def _known_packets(packets: VelodynePackets, beams: Beams, topic: str) -> Bools:
    """Mask of the packets with blocks that are marked as this model marks them."""
    layout = beams.layout
    words = packets.fields["blocks"]["flag"]
    flags = np.stack([words[:, beams.blocks + layout.apart * echo] for echo in range(len(layout.returns))])
    expected = flags == beams.flags
    known = np.asarray(expected.all(axis=(0, 2, 3)))
    if not known.any():
        found = int(flags[~expected][0])
        raise MessageError(
            f"{topic}: expected packets of a {beams.model.name}, found blocks that begin 0x{found:04x}; "
            "see velodyne.model"
        )
    return known


def _drop(message: RawMessage, reason: str, detail: str, parts: int) -> Drop:
    topic = message.topic
    return Drop(topic, message.stamp_ns, reason, detail if detail.startswith(topic) else f"{topic}: {detail}", parts)


# --- times


def _device_us(packets: VelodynePackets) -> I64:
    """(P,) microseconds from the last packet by the sensor's clock, which starts anew every hour."""
    clock_us = packets.fields["clock_us"].astype(np.int64)
    half = HOUR_US // 2
    return np.asarray((clock_us - clock_us[-1] + half) % HOUR_US - half)


def _packet_times(packets: VelodynePackets, device_us: I64, message: RawMessage) -> I64:
    """(P,) nanoseconds from the message's stamp; see the module docstring."""
    stamps_ns = packets.stamps_ns - packets.stamps_ns[-1]
    times_ns = device_us * 1000
    span_ns = int(times_ns.max() - times_ns.min())
    if span_ns > MAX_OFFSET_NS:
        raise MessageError(f"{message.topic}: expected a scan, found packets that span {span_ns / 1e9:.1f} s")
    times_ns += round(float(np.median(stamps_ns - times_ns))) + int(packets.stamps_ns[-1]) - message.stamp_ns
    if int(np.abs(times_ns).max()) > MAX_OFFSET_NS:
        times_ns -= times_ns[-1]
    return times_ns
