"""The sources of the boxes of a frame: networks, clusters, or the recording."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import chain
from operator import itemgetter
from os.path import isfile
from pathlib import Path
from typing import Any, Literal

from lidcam.networks.known import NETWORKS, fetched_network, network_path
from lidcam.pipeline.core.clouds import CombinedCloud
from lidcam.pipeline.core.detections import Boxes2D, Boxes3D
from lidcam.pipeline.core.errors import ModelError, RecordingError
from lidcam.pipeline.core.frame import Decoded, FrameResult, SensorBundle
from lidcam.pipeline.core.optics.images import Image
from lidcam.pipeline.core.rig import CameraSensor, LidarSensor, Rig
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.core.settings.detect import Detect2DConfig, Detect3DConfig
from lidcam.pipeline.detectors.cluster.kinds import knows
from lidcam.pipeline.detectors.given import FindInCloud, FindInImage, GivenDetector2D, GivenDetector3D
from lidcam.pipeline.detectors.onnx.class_names import COCO_LABELS
from lidcam.pipeline.detectors.onnx.providers import chosen
from lidcam.pipeline.detectors.pillars.embedded import EMBEDDED, network_file
from lidcam.pipeline.detectors.protocols import Detector2D
from lidcam.pipeline.graph import Graph, Node
from lidcam.readers.recording import Recording
from lidcam.readers.rig.sensor_topics import BOXES, IMAGE
from lidcam.readers.streams.decoders import ImageDecoder, OnBadMessage, RecordedBoxes

BoxSource = Literal["onnx", "recorded", "callable", "none"]

DetectInCloud = Callable[[CombinedCloud], Boxes3D]
DetectInImages = Callable[[Mapping[str, Image], CombinedCloud], Mapping[str, Boxes2D]]

FOUND = "found"
"""Name of the 3D boxes that are not recorded."""

ADVICE = "The cameras are not used. Type `lidcam fetch yolox-nano`, then run this again."


@dataclass
class KnownBoxes:
    """Boxes that were found before the run, in clouds and images; a frame of the same messages takes them over.

    Beside them are those boxes of the caller's functions that could not be used, by reason.
    """

    lidar: dict[object, tuple[Boxes3D, Mapping[str, int]]] = field(default_factory=dict)  # By messages of the lidars
    # By camera name, by the messages of lidars and cameras
    cameras: dict[object, tuple[Mapping[str, Boxes2D], Mapping[str, int]]] = field(default_factory=dict)

    def keep(self, rig: Rig, frame: FrameResult) -> None:
        """Keep the boxes of a frame."""
        bundle, detections = frame.bundle, frame.detections
        self.lidar[_messages(bundle, rig.lidars)] = detections.lidar, frame.unused_boxes3d
        self.cameras[_messages(bundle, rig.lidars, rig.cameras)] = detections.cameras, frame.unused_boxes

    def in_cloud(
        self,
        rig: Rig,
        detect: DetectInCloud,
        given: GivenDetector3D | None,
        bundle: SensorBundle,
        combined: CombinedCloud,
    ) -> Decoded[Boxes3D]:
        """The 3D boxes of a frame, detected unless they are known; `given` is the function of the caller in it."""
        known = self.lidar.get(_messages(bundle, rig.lidars))
        boxes, unused = known or (detect(combined), given.unused if given else {})
        return Decoded({FOUND: boxes}, unused_boxes=unused)

    def in_images(
        self,
        rig: Rig,
        detect: DetectInImages,
        given: GivenDetector2D | None,
        bundle: SensorBundle,
        images: Decoded[Image],
        combined: CombinedCloud,
    ) -> Decoded[Boxes2D]:
        """The same of the 2D boxes, with the images that cannot be decoded, whose stamps the run may have moved."""
        known = self.cameras.get(_messages(bundle, rig.lidars, rig.cameras))
        if known is None:
            return Decoded(detect(images, combined), images.drops, given.unused if given else {})
        moved = {name: replace(boxes, stamp_ns=images[name].stamp_ns) for name, boxes in known[0].items()}
        return Decoded(moved, images.drops, known[1])


def _messages(bundle: SensorBundle, *sensors: Iterable[LidarSensor | CameraSensor]) -> object:
    """The time of a frame, and the places in the recording of its messages of some sensors."""
    found = (bundle.messages.get(sensor.topic) for sensor in chain.from_iterable(sensors))
    return bundle.stamp_ns, tuple(message and message.order for message in found)


def box_source(config: Config, rig: Rig) -> BoxSource:
    """The source of 2D boxes; `none` where no camera of the rig has them."""
    wanted = _wanted_boxes(config, rig)
    has_any = any(camera.boxes_topic if wanted == "recorded" else camera.topic for camera in rig.cameras)
    return wanted if has_any else "none"


def detects_in_images(config: Config, rig: Rig) -> bool:
    """Whether 2D boxes are sought in the images of the cameras."""
    return box_source(config, rig) in {"onnx", "callable"}


def with_network_2d(config: Config, recording: Recording, rig: Rig) -> Config:
    """The settings with `detect2d.model` decided: `auto` becomes a fetched network if cameras have images alone."""
    topics = {info.topic for info in recording.topics if info.msgtype in IMAGE and info.message_count}
    has_images = any(camera.topic in topics for camera in rig.cameras)
    model = fetched_network() if has_images and _may_fetch(config, rig) else None
    update = {"detect2d": config.detect2d.model_copy(update={"model": model})}
    return config.model_copy(update=update) if model else config


def with_device(config: Config) -> Config:
    """The settings with the providers decided that are `auto`: results say what ran their networks."""
    sections: dict[str, Detect2DConfig | Detect3DConfig] = {"detect2d": config.detect2d, "detect3d": config.detect3d}
    update = {
        name: section.model_copy(update={"provider": chosen(section.provider)})
        for name, section in sections.items()
        if section.provider == "auto"
    }
    return config.model_copy(update=update) if update else config


def boxes_2d_words(config: Config, rig: Rig) -> tuple[str, str]:
    """The source of 2D boxes in words, and what to type where cameras lack a network; mostly empty."""
    source, model = box_source(config, rig), str(config.detect2d.model)
    if source != "none":
        words = {"recorded": "as recorded", "callable": "a function of the caller"}
        return words.get(source, f"network {Path(model).name}"), ""
    if not rig.cameras:
        return "none (no usable camera)", ""
    lacks = _may_fetch(config, rig) and any(camera.topic for camera in rig.cameras)
    remedy = "recorded 2D boxes, or a 2D network (lidcam fetch, --model-2d FILE.onnx), enable the cameras"
    return f"none (lidar-only); {remedy}", ADVICE if lacks else ""


def _may_fetch(config: Config, rig: Rig) -> bool:
    """Whether a network from `lidcam fetch`, which knows COCO's classes, is wanted and of use."""
    is_open = config.detect2d.model == "auto" and _wanted_boxes(config, rig) in {"onnx", "none"}
    return is_open and config.detect2d.method != "none" and not set(COCO_LABELS).isdisjoint(config.class_id_of_label)


def engine_3d(config: Config) -> str:
    """The 3D engine, a name of `ENGINES`; `auto` combines network and clusters where there is a network."""
    if config.detect3d.method != "auto":
        return config.detect3d.method
    return "combined" if network_3d(config) else "cluster"


def network_3d(config: Config) -> Path | None:
    """The file of the 3D network: as set, or the embedded one for these classes; None without a network.

    A `detect3d.score` without a method selects clusters alone, whose score it is.
    """
    detect3d = config.detect3d
    if detect3d.method not in {"auto", "pillars", "combined"}:
        return None
    if detect3d.model is not None:
        return network_file(detect3d.model)
    is_wanted = detect3d.method != "auto" or detect3d.score == "auto"
    return EMBEDDED["traffic"] if is_wanted and knows(config.classes) else None


def check_box_source(config: Config, recording: Recording, rig: Rig) -> None:
    """Check that the recording has messages for the 2D boxes; unusable cameras are faults of the rig."""
    wanted = _wanted_boxes(config, rig)
    if wanted == "none":
        return
    expected, needed, remedy = {
        "onnx": ("images for the 2D network", IMAGE, "leave out --model-2d"),
        "recorded": ("recorded 2D boxes", BOXES, "set detect2d.method to auto"),
        "callable": ("images for detector_2d", IMAGE, "leave it out"),
    }[wanted]
    if not any(info.msgtype in needed and info.message_count for info in recording.topics):
        raise RecordingError(
            f"{', '.join(map(str, recording.paths))}: expected {expected} ({' or '.join(sorted(needed))}), found no "
            f"such topic with messages; {remedy} to go by the lidars alone"
        )


def add_boxes3d(
    graph: Graph[SensorBundle],
    config: Config,
    rig: Rig,
    combined: Node[CombinedCloud],
    known: KnownBoxes,
    given: FindInCloud | None = None,
    *,
    on_bad: OnBadMessage,
) -> tuple[Node[Decoded[Boxes3D]], Node[Boxes3D]]:
    """The decoded messages of recorded 3D detectors, or what was found in the cloud; the frame's 3D boxes."""
    # Behind the imports of programs that detect nothing.
    from lidcam.pipeline.stages.detect3d import Detect3D, Recorded3D

    if config.detect3d.method != "recorded":
        detector = None if given is None else GivenDetector3D(given, config)
        detect = Detect3D(rig, config, has_2d_boxes=box_source(config, rig) != "none", detector=detector)
        found = graph.add_stage("detect 3D", partial(known.in_cloud, rig, detect, detector), graph.frame, combined)
        return found, graph.add_stage("3D boxes", itemgetter(FOUND), found, timed=False)
    from lidcam.readers.streams.recorded3d import RecordedBoxes3D

    recorded = graph.add_stage("read 3D boxes", RecordedBoxes3D(rig, config, on_bad=on_bad), graph.frame)
    return recorded, graph.add_stage("join 3D boxes", Recorded3D(rig), graph.frame, recorded)


def add_boxes2d(
    graph: Graph[SensorBundle],
    config: Config,
    rig: Rig,
    combined: Node[CombinedCloud],
    known: KnownBoxes,
    given: FindInImage | None = None,
    *,
    on_bad: OnBadMessage,
) -> tuple[Node[Decoded[Boxes2D]], frozenset[tuple[int, int]], frozenset[int]]:
    """The 2D boxes by camera name, `riders` and `unknown_ids` of `Detect2D`.

    Raises:
        ModelError: the network cannot be loaded.
    """
    source = _wanted_boxes(config, rig)
    if source == "none":
        return graph.add_stage("no 2D boxes", _nothing, graph.frame, timed=False), frozenset(), frozenset()
    if source == "recorded":
        recorded = graph.add_stage("read 2D boxes", RecordedBoxes(rig, config, on_bad=on_bad), graph.frame)
        return recorded, frozenset(), frozenset()
    from lidcam.pipeline.stages.detect2d import Detect2D

    images = graph.add_stage("decode images", ImageDecoder(rig, config, on_bad=on_bad), graph.frame)
    caller = None if given is None else GivenDetector2D(given, config)
    detect = Detect2D(rig, config, caller or _network_2d(config))
    detect_or_known = partial(known.in_images, rig, detect, caller)
    found = graph.add_stage("detect 2D", detect_or_known, graph.frame, images, combined)
    return found, detect.riders, detect.unknown_ids


def _network_2d(config: Config) -> Detector2D:
    model = config.detect2d.model
    if not isinstance(model, Path):
        raise ModelError(
            "2D detection by onnx needs a model: run lidcam fetch yolox-nano, or give --model-2d FILE.onnx"
        )
    if str(model) in NETWORKS and not isfile(network_path(model)):  # noqa: PTH113  # Path.is_file may raise
        raise ModelError(f"{model}: is not on this machine yet: run lidcam fetch {model}")
    from lidcam.pipeline.detectors.onnx.detector import OnnxDetector2D

    return OnnxDetector2D(network_path(model), config.detect2d)


def _wanted_boxes(config: Config, rig: Rig) -> BoxSource:
    """The source of 2D boxes by the settings; `auto`: the model if one is decided, else recorded boxes, else none."""
    if config.detect2d.method != "auto":
        return config.detect2d.method
    if isinstance(config.detect2d.model, Path):
        return "onnx"
    return "recorded" if any(camera.boxes_topic for camera in rig.cameras) else "none"


def _nothing(_: SensorBundle) -> Decoded[Any]:
    return Decoded({})
