"""A recording of a minute, some tens of megabytes in many chunks, for tests that look at parts of it."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from builders import pointcloud2, raw, tf_message, transform_stamped, write_mcap

from lidcam.pipeline.core.messages import RawMessage

START_NS = 1_700_000_000 * 10**9
SECOND_NS = 10**9
LENGTH_S = 60
MESSAGES = 1 + 60 * LENGTH_S

TF = "tf2_msgs/msg/TFMessage"


def write_long_recording(path: Path) -> None:
    """A lidar of 10 Hz on a vehicle that drives, its pose at 50 Hz in the same chunks; the mounting comes first."""
    write_mcap(path, _recorded(), "zstd", chunk_bytes=1 << 17)


def _recorded() -> Iterator[RawMessage]:
    rng = np.random.default_rng(0)
    mounting = transform_stamped("base_link", "lidar", stamp_ns=START_NS, translation=(0, 0, 2))
    yield raw("/tf_static", TF, tf_message([mounting]), START_NS)
    for tenth in range(10 * LENGTH_S):
        stamp_ns = START_NS + tenth * SECOND_NS // 10
        cloud = pointcloud2(10 * rng.random((2000, 3)), stamp_ns=stamp_ns, frame_id="lidar")
        yield raw("/points", "sensor_msgs/msg/PointCloud2", cloud, stamp_ns)
        for place in range(5):
            at_ns = stamp_ns + place * SECOND_NS // 50
            ahead_m = (at_ns - START_NS) / 1e9
            pose = transform_stamped("odom", "base_link", stamp_ns=at_ns, translation=(ahead_m, 0, 0))
            yield raw("/tf", TF, tf_message([pose]), at_ns)
