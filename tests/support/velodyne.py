"""Packets of every Velodyne, drawn at random, and what velodyne-decoder makes of them."""

import sqlite3
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import builders
import numpy as np
import numpy.typing as npt
import velodyne_decoder as vd

from lidcam.pipeline.core.arrays import I64, U8
from lidcam.pipeline.core.clouds import PointCloud
from lidcam.pipeline.core.messages import Channel, RawMessage
from lidcam.readers.velodyne.models import MODELS, LaserTable, VelodyneModel, built_in_table

SCAN = "velodyne_msgs/msg/VelodyneScan"
TOPIC = "/velodyne_packets"
START_NS = 1_000_000_000_000  # early, so that the judge's float64 seconds resolve a tenth of a nanosecond

JUDGES = {
    "VLP-16": vd.Model.VLP16,
    "Puck Hi-Res": vd.Model.PuckHiRes,
    "HDL-32E": vd.Model.HDL32E,
    "HDL-64E S2": vd.Model.HDL64E_S2,
    "HDL-64E S3": vd.Model.HDL64E_S3,
    "VLP-32A": vd.Model.VLP32A,
    "VLP-32B": vd.Model.VLP32B,
    "VLP-32C": vd.Model.VLP32C,
    "VLS-128": vd.Model.VLS128,
}


def scan(
    payload: U8,
    stamps_ns: npt.ArrayLike,
    *,
    stamp_ns: int | None = None,
    encoding: builders.Encoding = "cdr",
    frame_id: str = "velodyne",
    topic: str = TOPIC,
) -> RawMessage:
    """A VelodyneScan as rosbags writes it; the header has the first packet's stamp unless `stamp_ns` says otherwise."""
    stamps = np.asarray(stamps_ns, np.int64).tolist()
    stamp_ns = (stamps[0] if stamps else START_NS) if stamp_ns is None else stamp_ns
    packets = [{"stamp": builders.time(at), "data": data} for at, data in zip(stamps, payload, strict=True)]
    fields = {"header": builders.header(stamp_ns, frame_id), "packets": packets}
    return builders.raw(topic, SCAN, fields, stamp_ns, encoding=encoding)


def packet_stream(
    payload: U8, stamps_ns: npt.ArrayLike, *, encoding: builders.Encoding = "cdr", topic: str = TOPIC
) -> list[RawMessage]:
    """VelodynePackets as rosbags writes them, recorded at their stamps."""
    msgtype = "velodyne_msgs/msg/VelodynePacket"
    channel = builders.channel(topic, msgtype, encoding)
    store = builders.store_for(encoding)
    stream = []
    for order, (at, data) in enumerate(zip(np.asarray(stamps_ns, np.int64).tolist(), payload, strict=True)):
        packet = builders.serialize(msgtype, {"stamp": builders.time(at), "data": data}, encoding, store)
        stream.append(RawMessage(at, at, (0, order), packet, channel))
    return stream


def random_packets(name: str, *, mode: int = 0x37, packets: int = 40, start: int = 35_000) -> tuple[U8, I64]:
    """Payload (P, 1206) and stamps of packets of one model: any range and reflectivity, a third without return."""
    rng = np.random.default_rng(0)
    model, dual = MODELS[name], mode == 0x39
    columns = model.columns_dual if dual else model.columns
    per_column = 2 * model.banks if dual else model.banks
    packet_us = columns * model.column_us
    times_us = np.rint(np.arange(packets) * packet_us).astype(np.int64)
    column_us = times_us[:, None] + np.arange(columns) * model.column_us
    azimuth = (start + np.rint(column_us * 10.0 * 36000e-6)).astype(np.int64) % 36000

    payload = np.full((packets, 1206), 0xFF, np.uint8)
    blocks = payload[:, :1200].reshape(packets, 12, 100)
    used = blocks[:, : columns * per_column]
    bank = np.arange(per_column) // 2 if dual and name == "VLS-128" else np.arange(per_column) % model.banks
    flags = np.array([0xEEFF, 0xDDFF, 0xCCFF, 0xBBFF], "<u2")[np.tile(bank, columns)]
    used[:, :, :2] = flags.view(np.uint8).reshape(-1, 2)
    used[:, :, 2:4] = np.repeat(azimuth, per_column, axis=1).astype("<u2")[..., None].view(np.uint8)
    steps = rng.integers(100, 40_000, (*used.shape[:2], 32))
    steps[rng.random(steps.shape) < 0.3] = 0
    if dual:
        second = 2 if model.product is None else 1
        pairs = steps.reshape(packets, -1, 2, second * 32)
        same = rng.random(pairs[:, :, 0].shape) < 0.4
        pairs[:, :, 1][same] = pairs[:, :, 0][same]
    echoes = np.empty((*steps.shape, 3), np.uint8)
    echoes[..., :2] = steps.astype("<u2")[..., None].view(np.uint8)
    echoes[..., 2] = rng.integers(0, 256, steps.shape)
    used[:, :, 4:] = echoes.reshape(*used.shape[:2], 96)
    payload[:, 1200:1204] = ((START_NS // 1000 + times_us) % 3_600_000_000).astype("<u4")[:, None].view(np.uint8)
    factory = rng.integers(0, 256, (packets, 2)) if model.product is None else np.array([mode, model.product])
    payload[:, 1204:] = factory
    return payload, START_NS + times_us * 1000


def judged(name: str, payload: U8, stamps_ns: I64, calibration: Path | None = None, before: int = 0) -> Any:
    """Points of velodyne-decoder, a structured array; `before` packets are decoded first, as a scan of their own."""
    settings: dict[str, Any] = {"model": JUDGES[name], "min_range": 0.0, "max_range": 300.0}
    if calibration is not None:
        settings["calibration"] = vd.Calibration.read(str(calibration))
    decoder = vd.ScanDecoder(vd.Config(**settings))
    packets = [vd.VelodynePacket(at / 1e9, data.tolist()) for at, data in zip(stamps_ns, payload, strict=True)]
    if before:
        decoder.decode(vd.PacketVector(packets[:before]))
    _, points = decoder.decode(vd.PacketVector(packets[before:]), as_pcl_structs=True)
    return points


def assert_as_judged(cloud: PointCloud, points: Any, name: str, table: LaserTable | None = None) -> None:
    """The same points: 2 mm plus 0.01 degrees, times to a microsecond, all else equal; `table` if not the built-in."""
    assert len(cloud) == len(points)
    assert cloud.return_type is not None
    ours = theirs = np.arange(len(points))
    if len(np.unique(points["return_type"])) > 1:  # the judge takes echo by echo, we take block by block
        columns = _columns(cloud, MODELS[name], table or built_in_table(name))
        ours = np.lexsort((cloud.return_type, cloud.ring, columns))
        theirs = np.lexsort((points["return_type"], points["ring"], points["column"]))
    points = points[theirs]
    xyz = np.stack([points[axis] for axis in "xyz"], axis=1)
    error_m = np.linalg.norm(cloud.xyz[ours] - xyz, axis=1)
    allowed_m = 0.002 + np.deg2rad(0.01) * np.linalg.norm(xyz, axis=1)
    np.testing.assert_array_less(error_m, allowed_m)
    np.testing.assert_array_equal(cloud.ring[ours], points["ring"])
    np.testing.assert_allclose(cloud.intensity[ours], points["intensity"], atol=1e-3)
    np.testing.assert_array_equal(cloud.return_type[ours], points["return_type"])
    time_s = cloud.time_offset_ns[ours] / 1e9
    np.testing.assert_allclose(time_s - time_s[-1], points["time"] - points["time"][-1], rtol=0, atol=1e-6)


def _columns(cloud: PointCloud, model: VelodyneModel, table: LaserTable) -> I64:
    """A number for the firing that each point is of, rising with time."""
    laser = np.argsort(table.elevation_rad, kind="stable")[cloud.ring]
    slot_us = np.array(model.slot_us).reshape(-1)[: model.lasers]
    began_ns = cloud.time_offset_ns - np.rint(slot_us * 1000).astype(np.int64)[laser]
    return np.asarray((began_ns - began_ns.min() + 500) // 1000)


def recorded_scans(path: Path) -> Iterator[RawMessage]:
    """The scans of a rosbag2 in SQLite, read by hand: its definitions and its serialization format may be missing."""
    with sqlite3.connect(f"file:{path}?mode=ro&immutable=1", uri=True) as database:
        rows = database.execute("SELECT timestamp, data FROM messages ORDER BY id").fetchall()
    database.close()
    channel = Channel(TOPIC, SCAN, "cdr")
    for log_time_ns, data in rows:
        sec, nanosec = np.frombuffer(data, "<u4", 2, 4).tolist()
        yield RawMessage(sec * 10**9 + nanosec, log_time_ns, (0, 0), data, channel)
