"""A drive of a second as messages: a lidar, a camera with its calibration and boxes, and the vehicle's motion."""

from collections.abc import Sequence
from typing import Literal

import numpy as np
from builders import camera_info, detection2d_array, image, odometry, pointcloud2, raw, tf_message, transform_stamped

from lidcam.pipeline.core.messages import RawMessage

START_NS = 1_700_000_000 * 10**9
STEP_NS = 100_000_000
CAMERA_K = np.array([[50.0, 0, 32], [0, 50, 24], [0, 0, 1]])
TO_OPTICAL = (-0.5, 0.5, -0.5, 0.5)


def small_drive(
    encoding: Literal["ros1", "cdr"] = "ros1",
    *,
    frames: int = 12,
    motion: Literal["odometry", "tf", "none"] = "odometry",
    kinds: Sequence[Literal["images", "boxes"]] = ("images",),
) -> list[RawMessage]:
    """Its messages in the order of log time, which is 5 ms (lidar), 8 ms (camera) and 1 ms (motion) after the stamp."""
    chance = np.random.default_rng(0)
    points = chance.uniform([5, -5, -1], [15, 5, 1], (200, 3)).astype(np.float32)
    times = np.linspace(0, 0.09, len(points), dtype=np.float32)
    edges = [
        transform_stamped("base_link", "lidar", stamp_ns=START_NS, translation=(0, 0, 1)),
        transform_stamped("base_link", "cam", stamp_ns=START_NS, rotation_xyzw=TO_OPTICAL),
    ]
    messages = [raw("/tf_static", "tf2_msgs/msg/TFMessage", tf_message(edges), START_NS, encoding=encoding)]
    for number in range(frames):
        at_ns = START_NS + number * STEP_NS
        moved = (0.5 * number, 0.0, 0.0)
        if motion == "odometry":
            pose = odometry(stamp_ns=at_ns, position=moved)
            messages.append(raw("/odom", "nav_msgs/msg/Odometry", pose, at_ns, at_ns + 1_000_000, encoding))
        elif motion == "tf":
            pose = tf_message([transform_stamped("odom", "base_link", stamp_ns=at_ns, translation=moved)])
            late_ns = at_ns + 1_000_000
            messages.append(raw("/tf", "tf2_msgs/msg/TFMessage", pose, late_ns, late_ns, encoding))
        info = camera_info(CAMERA_K, stamp_ns=at_ns, width_px=64, height_px=48, frame_id="cam")
        messages.append(raw("/cam/camera_info", "sensor_msgs/msg/CameraInfo", info, at_ns, at_ns + 2_000_000, encoding))
        cloud = pointcloud2(points, stamp_ns=at_ns, intensity=points[:, 0] + np.float32(0.01 * number), time=times)
        messages.append(raw("/points", "sensor_msgs/msg/PointCloud2", cloud, at_ns, at_ns + 5_000_000, encoding))
        if "images" in kinds:
            pixels = np.full((48, 64, 3), number, np.uint8)
            shot = image(pixels, stamp_ns=at_ns, frame_id="cam")
            messages.append(raw("/cam/image_raw", "sensor_msgs/msg/Image", shot, at_ns, at_ns + 8_000_000, encoding))
        if "boxes" in kinds:
            boxes = detection2d_array(
                [[10, 10, 30, 30]], class_names=["car"], scores=[0.9], stamp_ns=at_ns, frame_id="cam"
            )
            kind = "vision_msgs/msg/Detection2DArray"
            messages.append(raw("/cam/detections", kind, boxes, at_ns, at_ns + 9_000_000, encoding))
    return messages
