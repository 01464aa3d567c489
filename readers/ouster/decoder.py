"""Decodes sweeps of an Ouster's packets to the points that ouster-ros makes of them."""

import numpy as np

from lidcam.pipeline.core.clouds import PointCloud
from lidcam.pipeline.core.errors import MessageError
from lidcam.pipeline.core.messages import RawMessage
from lidcam.pipeline.core.settings.recording import DEFAULT_LIMITS, RecordingLimits
from lidcam.readers.messages.decoding import decoder
from lidcam.readers.messages.deserialize import deserialize_as
from lidcam.readers.messages.pointcloud2 import MAX_OFFSET_NS, check_points
from lidcam.readers.messages.tf import clean_frame
from lidcam.readers.ouster.packets import SWEEP
from lidcam.readers.ouster.sensor import sdk, sensor_of


@decoder
def decode_ouster(
    message: RawMessage, *, limits: RecordingLimits = DEFAULT_LIMITS, others: int = 0, calibrated: bool = True
) -> PointCloud:
    """The first returns of a sweep, row by row and by azimuth, in the lidar's own frame, as `/ouster/points` has them.

    Returns:
        The cloud at the message's stamp. Rings are the rows from the top; times count from the first column of the
        turn. Intensity is the reflectivity, or the signal if it need not be `calibrated` and the profile has it. Beams
        without a return are counted in `nan_dropped`.
    """
    sweep, topic = deserialize_as(message, SWEEP, limits=limits), message.topic
    try:
        sensor = sensor_of(str(sweep.metadata))
    except MessageError as err:
        raise MessageError(f"{topic}: {err}") from err
    core, size, found = sdk(), sensor.packet_bytes, len(sweep.packets)
    check_points(sensor.columns, topic, limits, others, rows=sensor.rows)
    if not found or found % size:
        raise MessageError(f"{topic}: expected packets of {size} bytes, found {found} bytes")
    frame, batcher = core.LidarFrame(sensor.info), core.FrameBatcher(sensor.info)
    packet = core.LidarPacket(sensor.packets)
    for data in sweep.packets.reshape(-1, size):  # 64 in a turn, or 128
        packet.buf[:] = data
        batcher.batch(packet, frame)
    if not frame.has_field("RANGE"):
        raise MessageError(f"{topic}: packets of profile {sensor.packets.udp_profile_lidar.name}, which has no ranges")
    valid = (np.asarray(frame.status) & 1).astype(bool)
    offsets_ns = np.where(valid, np.asarray(frame.timestamp).astype(np.int64) - int(sweep.begin_ns), 0).clip(min=0)
    if offsets_ns.max() > MAX_OFFSET_NS:
        raise MessageError(f"{topic}: expected a turn, found packets that span {offsets_ns.max() / 1e9:.1f} s")
    ranges = np.asarray(frame.field("RANGE"))
    keep = sensor.order[((ranges > 0) & valid).reshape(-1)[sensor.order]]
    brightness = np.asarray(frame.field("REFLECTIVITY" if calibrated or not frame.has_field("SIGNAL") else "SIGNAL"))
    rows, columns = np.divmod(keep, sensor.columns)
    return PointCloud(
        stamp_ns=message.stamp_ns,
        frame_id=clean_frame(sweep.header.frame_id),
        xyz=sensor.points(ranges).reshape(-1, 3)[keep],
        intensity=brightness.reshape(-1)[keep].astype(np.float32),
        ring=rows.astype(np.uint16),
        time_offset_ns=offsets_ns[columns].astype(np.int32),
        has_time=True,
        nan_dropped=ranges.size - len(keep),
    )
