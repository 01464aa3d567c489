"""The whole data flow on one screen."""

from collections.abc import Mapping
from typing import Literal

from pipeline.core.clouds import CombinedCloud, PointCloud
from pipeline.core.detections import Boxes2D, Boxes3D, Matches
from pipeline.core.errors import ModelError
from pipeline.core.frame import FrameResult, SensorBundle
from pipeline.core.images import Image
from pipeline.core.rig import Rig
from pipeline.core.settings.config import Config
from pipeline.detectors.onnx2d import OnnxDetector2D
from pipeline.graph import Graph, Node
from pipeline.stages.associate import Associate
from pipeline.stages.combine import Combine
from pipeline.stages.detect2d import Detect2D
from pipeline.stages.detect3d import Detect3D
from pipeline.stages.fuse import Fuse, Fused
from readers.streams.decoders import CloudDecoder, Decoded, OnBadMessage, PictureDecoder, RecordedBoxes

__all__ = ["BoxSource", "box_source", "build_graph", "wanted_boxes"]

BoxSource = Literal["onnx", "recorded", "none"]


def build_graph(config: Config, rig: Rig, *, on_bad: OnBadMessage) -> tuple[Graph[SensorBundle], Node[FrameResult]]:
    """The stages from a bundle of undecoded messages to a frame's result.

    Raises:
        ModelError: the 2D network cannot be loaded.
    """
    combine, detect3d, associate, fuse = (
        Combine(rig, config.combine),
        Detect3D(rig, config),
        Associate(rig, config),
        Fuse(config),
    )
    graph = Graph(SensorBundle)
    clouds = graph.add("decode clouds", CloudDecoder(rig, config, on_bad=on_bad), graph.frame)
    combined = graph.add(
        "combine", lambda bundle, clouds: combine(bundle, clouds.by_sensor), graph.frame, clouds, workers=2
    )
    boxes3d = graph.add("detect 3D", detect3d, combined)
    boxes2d = _add_boxes2d(graph, config, rig, on_bad=on_bad)
    matches = graph.add("associate", lambda boxes3d, boxes2d: associate(boxes3d, boxes2d.by_sensor), boxes3d, boxes2d)
    fused = graph.add("fuse", lambda b3, b2, matches: fuse(b3, b2.by_sensor, matches), boxes3d, boxes2d, matches)
    return graph, graph.add("collect", _collect, graph.frame, clouds, combined, boxes3d, boxes2d, matches, fused)


def box_source(config: Config, rig: Rig) -> BoxSource:
    """Where 2D boxes come from; none where no camera of the rig has what is wanted."""
    wanted = wanted_boxes(config, rig)
    found = {
        "onnx": any(camera.topic for camera in rig.cameras),
        "recorded": any(camera.boxes_topic for camera in rig.cameras),
        "none": True,
    }
    return wanted if found[wanted] else "none"


def wanted_boxes(config: Config, rig: Rig) -> BoxSource:
    """Where 2D boxes should come from: as set; `auto`: the model if one is given, else recorded boxes, else none."""
    if config.detect2d.method != "auto":
        return config.detect2d.method
    if config.detect2d.model is not None:
        return "onnx"
    return "recorded" if any(camera.boxes_topic for camera in rig.cameras) else "none"


def _add_boxes2d(
    graph: Graph[SensorBundle], config: Config, rig: Rig, *, on_bad: OnBadMessage
) -> Node[Decoded[Boxes2D]]:
    source = wanted_boxes(config, rig)
    if source == "none":
        return graph.add("no 2D boxes", _no_boxes, graph.frame)
    if source == "recorded":
        return graph.add("read 2D boxes", RecordedBoxes(rig, config, on_bad=on_bad), graph.frame)
    if config.detect2d.model is None:
        raise ModelError("2D detection by onnx needs a model: give --model-2d FILE.onnx or set detect2d.model")
    detect2d = Detect2D(rig, config, OnnxDetector2D(config.detect2d.model, config))
    pictures = graph.add("decode images", PictureDecoder(rig, config, on_bad=on_bad), graph.frame)

    def detect(pictures: Decoded[Image]) -> Decoded[Boxes2D]:
        return Decoded(detect2d(pictures.by_sensor), pictures.drops)

    return graph.add("detect 2D", detect, pictures)


def _no_boxes(_: SensorBundle) -> Decoded[Boxes2D]:
    return Decoded({})


def _collect(
    bundle: SensorBundle,
    clouds: Decoded[PointCloud],
    combined: CombinedCloud,
    lidar_boxes: Boxes3D,
    camera_boxes: Decoded[Boxes2D],
    matches: Mapping[str, Matches],
    fused: Fused,
) -> FrameResult:
    return FrameResult(
        bundle,
        combined,
        lidar_boxes,
        camera_boxes.by_sensor,
        matches,
        fused.objects,
        fused.matched,
        clouds.drops + camera_boxes.drops,
        camera_boxes.left_out,
    )
