"""Writes FrameResults to one MCAP file for Foxglove, Lichtblick, rosbag2 and ROS tools.

Profile `ros2`: CDR messages, definitions as `ros2msg` text with all dependencies (mcap.dev/spec/registry). Every
message of a frame has the log time of the frame's reference message; copied messages keep theirs, and where truth among
them is drawn, the drawing has the log time of the frame that it belongs to. Headers have the frame's stamp; an image
and its camera_info, annotations and detections have the image's own stamp, because viewers pair them by equality. Equal
results give equal bytes.
"""

from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from lidcam.pipeline.core.errors import MessageError, OutputError
from lidcam.pipeline.core.frame import FrameResult
from lidcam.pipeline.core.geometry.transform import Transform
from lidcam.pipeline.core.messages import Channel, Drop, RawMessage, time_fault
from lidcam.pipeline.core.rig import CameraSensor, Rig
from lidcam.pipeline.core.ros.messages import ROS2
from lidcam.pipeline.core.ros.qos import LATCHED_YAML
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.core.settings.run import OutputConfig
from lidcam.pipeline.core.true_boxes import TrueBoxes
from lidcam.writers.base import ResultWriter
from lidcam.writers.drawing import DrawnObjects, ObjectEdges, camera_image, object_edges
from lidcam.writers.foxglove.layout import FOV_Y_DEG, foxglove_layout, label_eye
from lidcam.writers.labels_3d import LabelPlaces
from lidcam.writers.mcap.output import Buffer, McapOutput, MessageSink, mcap_file
from lidcam.writers.messages import scene
from lidcam.writers.messages.annotations import image_annotations
from lidcam.writers.messages.detections import detections_2d, detections_3d, lidcam_objects, track_array
from lidcam.writers.messages.diagnostics import diagnostics
from lidcam.writers.messages.sensors import COMPRESSED, camera_info, cloud_message, image_cdr, static_transforms
from lidcam.writers.outputs.errors import output_errors
from lidcam.writers.outputs.marks import INPUTS, RESULT
from lidcam.writers.outputs.transaction import OutputFile
from lidcam.writers.provenance import Provenance
from lidcam.writers.trails import Trails
from lidcam.writers.truth_times import FrameTime, TruthTimes
from lidcam.writers.viewpoint import SceneSurvey

TRACKS = "/tracks"
"""Topic of the tracks; it has a message in each frame where objects are tracked."""

_LATER = ("/tf", TRACKS, scene.PLACED, scene.PLACED_SCENE)
"""Added with their first message, like images, whose type is known from their first message."""

_STAMP_END = 12
"""Bytes of CDR's encapsulation and of the stamp that a header begins with."""


def _written_topics(rig: Rig, output: OutputConfig) -> Iterator[tuple[str, str]]:
    """Topics of every file, those of `_LATER` and images aside."""
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
    return frozenset((*_LATER, *images, *(topic for topic, _ in _written_topics(rig, Config().output))))


class McapResultWriter(ResultWriter):
    """Writes one run's frames to a file, with their provenance as metadata and attachments, and a layout beside it."""

    name = "mcap"

    def __init__(
        self,
        output: OutputFile,
        rig: Rig,
        config: Config,
        provenance: Provenance,
        layout: OutputFile | None = None,
        *,
        frames: Sequence[Transform] = (),
    ) -> None:
        self._output, self._layout, self.path = output, layout, output.path
        self._rig, self._config, self._provenance, self._frames = rig, config, provenance, frames
        self._file: McapOutput
        self._messages: ResultMessages

    def _open(self, resources: ExitStack) -> None:
        compression = self._config.output.compression
        self._file = resources.enter_context(mcap_file(self._output.part, profile="ros2", compression=compression))
        self._file.add_metadata(RESULT, self._provenance.metadata())
        for name, text in (("lidcam.yaml", self._provenance.config_yaml), ("rig.yaml", self._provenance.rig_yaml)):
            self._file.attach(name, text, self._provenance.start_ns)
        self._messages = ResultMessages(self._file, self.path, self._rig, self._config, self._frames)

    def _finish(self) -> None:
        self._messages.finish()
        if later := self._provenance.checksums():
            self._file.add_metadata(INPUTS, later)
        self._file.attach("summary.json", self._provenance.summary(), self._provenance.start_ns, "application/json")
        if self._layout is not None:  # at the end: it names only topics that the file has
            self._layout.write_text(foxglove_layout(self._rig, self._messages.survey, self._messages.filled))

    def write(self, result: FrameResult) -> tuple[Drop, ...]:
        """Write one frame; returns images whose bytes do not fit their type."""
        with output_errors(self.path):
            return self._messages.add_frame(result)


class ResultMessages:
    """Makes the messages of one run's frames for a sink, which error messages call `path`.

    `frames` are T_site_frame of those that copied messages stand in.

    Attributes:
        filled: Topics that have messages.
        survey: Content of the first frames.

    Raises:
        OutputError: two topics have one name.
    """

    def __init__(
        self, sink: MessageSink, path: Path, rig: Rig, config: Config, frames: Sequence[Transform] = ()
    ) -> None:
        self._sink, self._path, self._rig, self._config, self._frames = sink, path, rig, config, frames
        self._channels: dict[str | Channel, int] = {}
        self._camera_infos: dict[str, bytes] = {}  # behind the stamps, which alone change
        self.filled: set[str] = set()
        self.survey = SceneSurvey(rig)
        self._label_places = LabelPlaces(self.survey, label_eye, FOV_Y_DEG)
        self._count = 0
        self._truth_times = TruthTimes()
        self._trails = Trails(rig.site_frame, config.combine.motion)
        for topic, msgtype in _written_topics(rig, config.output):
            if topic in self._channels or topic in _LATER:
                raise OutputError(f"{path}: two outputs are called {topic}; rename the camera of that name in the rig")
            self._channels[topic] = sink.add_ros2(topic, msgtype, LATCHED_YAML if topic == "/tf_static" else "")

    def add_frame(self, result: FrameResult) -> tuple[Drop, ...]:
        """Add the messages of one frame; returns images whose bytes do not fit their type.

        Raises:
            OutputError: a stamp does not fit a ROS 2 header.
        """
        bundle, log_time_ns, stamp_ns = result.bundle, result.bundle.log_time_ns, result.bundle.stamp_ns
        stamps_ns = [stamp_ns, *(message.stamp_ns for message in bundle.messages.values())]
        for fault in filter(None, map(time_fault, stamps_ns)):
            raise OutputError(
                f"{self._path}: frame {bundle.index}: a stamp does not fit a ROS 2 header, {fault}; "
                "cut that part off with --start and --duration"
            )
        self.survey.add_frame(result)
        self._add_recorded(message for message in bundle.copied if message.log_time_ns <= log_time_ns)
        if "/tf_static" not in self.filled:
            self._add("/tf_static", static_transforms(self._rig, min(stamps_ns), self._frames), log_time_ns)
        drawn = DrawnObjects.of(result, self._config.object_names)
        for topic, message in self._site_messages(drawn):
            self._add(topic, message, log_time_ns)
        not_copied: list[Drop] = []
        edges = object_edges(result, [camera.name for camera in self._rig.cameras])
        for camera in self._rig.cameras:
            not_copied += self._add_camera(drawn, camera, edges[camera.name])
        self._add("/diagnostics", diagnostics(result, self._rig, not_copied), log_time_ns)
        self._add_truth(self._truth_times.add_frame(bundle))
        self._add_recorded(message for message in bundle.copied if message.log_time_ns > log_time_ns)
        return tuple(not_copied)

    def finish(self) -> None:
        """Add what waited for the end of the run."""
        self._add_truth(self._truth_times.rest())

    def _site_messages(self, drawn: DrawnObjects) -> Iterator[tuple[str, Any]]:
        """Everything about a frame as a whole: motion, objects, what the lidars saw."""
        result, objects, names, tracks = drawn.result, drawn.boxes, drawn.class_names, drawn.result.fused.tracks
        stamp_ns, site_frame, motion = result.bundle.stamp_ns, self._rig.site_frame, result.bundle.motion
        if motion is not None and motion.covers(stamp_ns):
            pose = Transform(motion.fixed_frame_id, motion.frame_id, motion.at(stamp_ns)[0])
            yield "/tf", ROS2.transforms(stamp_ns, [pose])
        counted = objects.select(objects.class_ids < len(self._config.classes))
        yield "/lidar_camera_fused", lidcam_objects(counted, self._rig.counted_zones, stamp_ns=stamp_ns)
        yield "/fused/detections", detections_3d(objects, names, stamp_ns=stamp_ns, track_numbers=drawn.tracks)
        if tracks is not None:
            yield TRACKS, track_array(objects, tracks, names, stamp_ns=stamp_ns)
        trails, zones = self._trails.add_frame(result), scene.zone_entities(self.survey, objects)
        yield "/fused/scene", scene.scene_update(drawn, trails, self._label_places.of(drawn), zones)
        yield "/fused/markers", scene.marker_array(drawn)
        yield "/lidar/detections", detections_3d(result.detections.lidar, names, stamp_ns=stamp_ns)
        if (placed := result.detections.placed) is not None:
            yield scene.PLACED, detections_3d(placed, names, stamp_ns=stamp_ns)
            yield scene.PLACED_SCENE, scene.placed_scene(placed, names, stamp_ns=stamp_ns)
        clouds = {"/point_cloud_combined": result.combined.cloud, "/ground_cloud": result.combined.ground_cloud}
        for topic, cloud in clouds.items():
            if topic in self._channels:  # as the settings of the output say
                yield topic, cloud_message(cloud, stamp_ns=stamp_ns, frame_id=site_frame)

    def _add_camera(self, drawn: DrawnObjects, camera: CameraSensor, edges: ObjectEdges) -> Iterable[Drop]:
        """Add the messages of a camera, all with the stamp of its image; returns an image that cannot be copied."""
        boxes, image = drawn.result.detections.cameras.get(camera.name), camera_image(drawn.result, camera)
        if image is None and boxes is None:
            return ()
        drops: tuple[Drop, ...] = ()
        log_time_ns, prefix, frame_id = drawn.result.bundle.log_time_ns, f"/{camera.name}", camera.T_camera_site.dst
        stamp_ns = image.stamp_ns if image is not None else boxes.stamp_ns if boxes is not None else 0
        if image is not None and self._config.output.images:
            try:
                cdr, msgtype = image_cdr(image, frame_id=frame_id), image.channel.msgtype
                topic = f"{prefix}/image/compressed" if msgtype == COMPRESSED else f"{prefix}/image"
                self._add_cdr(topic, msgtype, cdr, log_time_ns)
            except MessageError as err:
                drops = (Drop(image.topic, image.stamp_ns, "the image cannot be copied", str(err)),)
        if camera.name not in self._camera_infos:
            self._camera_infos[camera.name] = ROS2.serialize(camera_info(camera, stamp_ns))[_STAMP_END:]
        info = b"".join((ROS2.serialize(ROS2.time(stamp_ns)), self._camera_infos[camera.name]))
        self._add_cdr(f"{prefix}/camera_info", "sensor_msgs/msg/CameraInfo", info, log_time_ns)
        self._add(f"{prefix}/annotations", image_annotations(drawn, camera, edges, stamp_ns=stamp_ns), log_time_ns)
        if boxes is not None:
            found = detections_2d(boxes, drawn.class_names, stamp_ns=stamp_ns, frame_id=frame_id)
            self._add(f"{prefix}/detections", found, log_time_ns)
        return drops

    def _add_recorded(self, messages: Iterable[RawMessage]) -> None:
        """Add recorded messages as they are, at the times at which they were recorded."""
        for message in messages:
            if message.channel not in self._channels:
                self._channels[message.channel] = self._sink.add_recorded(message.channel)
            self._sink.add_message(self._channels[message.channel], message.log_time_ns, message.data, self._count)
            self._count += 1

    def _add_truth(self, known: Iterable[tuple[FrameTime, TrueBoxes]]) -> None:
        for frame, truth in known:
            self._add(scene.truth_scene_topic(truth.topic), scene.truth_scene(truth), frame.log_time_ns)

    def _add(self, topic: str, message: Any, log_time_ns: int) -> None:
        self._add_cdr(topic, message.__msgtype__, ROS2.serialize(message), log_time_ns)

    def _add_cdr(self, topic: str, msgtype: str, cdr: Buffer, log_time_ns: int) -> None:
        if topic not in self._channels:
            self._channels[topic] = self._sink.add_ros2(topic, msgtype)
        self._sink.add_message(self._channels[topic], log_time_ns, cdr, self._count)
        self.filled.add(topic)
        self._count += 1
