"""Names and types of the topics that a result has."""

from collections.abc import Iterator

from pipeline.core.rig import Rig
from pipeline.core.settings.config import Config
from pipeline.core.settings.run import OutputConfig
from writers.messages.edge_scenes import PLACED, PLACED_SCENE

__all__ = ["LATER", "reserved_topics", "written_topics"]

LATER = ("/tf", PLACED, PLACED_SCENE)
"""Added with their first message, like images, whose first message tells their type."""


def written_topics(rig: Rig, output: OutputConfig) -> Iterator[tuple[str, str]]:
    """Topics of every file, those of `LATER` and images aside."""
    yield "/tf_static", "tf2_msgs/msg/TFMessage"
    yield "/lidar_camera_fused", "msgs/msg/MsgLidCam"
    yield "/fused/detections", "vision_msgs/msg/Detection3DArray"
    yield "/fused/scene", "foxglove_msgs/msg/SceneUpdate"
    yield "/fused/markers", "visualization_msgs/msg/MarkerArray"
    yield "/lidar/detections", "vision_msgs/msg/Detection3DArray"
    if output.clouds:
        yield "/point_cloud_combined", "sensor_msgs/msg/PointCloud2"
        if output.ground:
            yield "/ground_cloud", "sensor_msgs/msg/PointCloud2"
    for camera in rig.cameras:
        yield f"/{camera.name}/camera_info", "sensor_msgs/msg/CameraInfo"
        yield f"/{camera.name}/annotations", "foxglove_msgs/msg/ImageAnnotations"
        yield f"/{camera.name}/detections", "vision_msgs/msg/Detection2DArray"
    yield "/diagnostics", "diagnostic_msgs/msg/DiagnosticArray"


def reserved_topics(rig: Rig) -> frozenset[str]:
    """Topics of a result with every setting of the output: nothing else is written under these names."""
    images = [f"/{camera.name}/image{suffix}" for camera in rig.cameras for suffix in ("", "/compressed")]
    return frozenset((*LATER, *images, *(topic for topic, _ in written_topics(rig, Config().output))))
