"""How a bundle becomes a result: the stages of a frame; `lidcam.frames` says where bundles come from."""

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import Any, Literal

from pipeline.core.clouds import CombinedCloud, PointCloud
from pipeline.core.detections import Boxes2D, Boxes3D, Detections, Fused, Hypotheses, Matches
from pipeline.core.errors import ModelError
from pipeline.core.frame import Decoded, FrameResult, SensorBundle
from pipeline.core.rig import CameraSensor, Rig
from pipeline.core.settings.config import Config
from pipeline.detectors.onnx.detector import OnnxDetector2D
from pipeline.fusion.zones import select_by_zones
from pipeline.graph import Graph, Node
from pipeline.stages.associate import Associate
from pipeline.stages.combine import Combine
from pipeline.stages.detect2d import Detect2D
from pipeline.stages.detect3d import Detect3D
from pipeline.stages.fuse import Fuse
from pipeline.stages.recorded3d import Recorded3D
from pipeline.stages.views import Views
from readers.streams.decoders import CloudDecoder, ImageDecoder, OnBadMessage, RecordedBoxes
from readers.streams.recorded3d import RecordedBoxes3D

__all__ = ["BoxSource", "BoxSource3D", "box_source", "build_graph", "wanted_boxes"]

BoxSource = Literal["onnx", "recorded", "none"]
BoxSource3D = Literal["cluster", "recorded", "none"]


def build_graph(config: Config, rig: Rig, *, on_bad: OnBadMessage) -> tuple[Graph[SensorBundle], Node[FrameResult]]:
    """The stages from a bundle of undecoded messages to a frame's result.

    Raises:
        ModelError: the 2D network cannot be loaded.
    """
    graph = Graph(SensorBundle)
    clouds = graph.add("decode clouds", CloudDecoder(rig, config, on_bad=on_bad), graph.frame)
    combined = graph.add("combine", Combine(rig, config.combine), graph.frame, clouds, workers=2)
    recorded3d, boxes3d = _add_boxes3d(graph, config, rig, combined, on_bad=on_bad)
    camera_data, boxes2d = _add_boxes2d(graph, config, rig, on_bad=on_bad)
    views = graph.add("views", Views(rig, config), graph.frame)
    matches = graph.add("associate", Associate(rig, config), boxes3d, boxes2d, views)
    hypotheses = graph.add("propose", _propose, boxes3d, matches)
    fused = graph.add("fuse", Fuse(config), hypotheses, boxes2d)
    fused = graph.add("zones", partial(select_by_zones, zones=rig.zones), fused)
    inputs = graph.frame, clouds, combined, boxes3d, camera_data, boxes2d, views, hypotheses, fused
    result = graph.add("collect", _collect, *inputs)
    return graph, result if recorded3d is None else graph.add("count 3D boxes", _with_recorded, result, recorded3d)


def box_source(config: Config, rig: Rig) -> BoxSource:
    """Where 2D boxes come from; `none` where no camera of the rig has them."""
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


def _add_boxes3d(
    graph: Graph[SensorBundle], config: Config, rig: Rig, combined: Node[CombinedCloud], *, on_bad: OnBadMessage
) -> tuple[Node[Decoded[Boxes3D]] | None, Node[Boxes3D]]:
    """What the messages of recorded 3D detectors held, if these are used; and the 3D boxes of the frame."""
    if config.detect3d.method != "recorded":
        return None, graph.add("detect 3D", Detect3D(rig, config), combined)
    recorded = graph.add("read 3D boxes", RecordedBoxes3D(rig, config, on_bad=on_bad), graph.frame)
    return recorded, graph.add("join 3D boxes", Recorded3D(rig), graph.frame, recorded)


def _add_boxes2d(
    graph: Graph[SensorBundle], config: Config, rig: Rig, *, on_bad: OnBadMessage
) -> tuple[Node[Decoded[Any]], Node[Mapping[str, Boxes2D]]]:
    """What the cameras' messages held, and the 2D boxes by camera name."""
    source = wanted_boxes(config, rig)
    if source == "none":
        nothing = graph.add("no 2D boxes", _nothing, graph.frame)
        return nothing, nothing
    if source == "recorded":
        recorded = graph.add("read 2D boxes", RecordedBoxes(rig, config, on_bad=on_bad), graph.frame)
        return recorded, recorded
    if config.detect2d.model is None:
        raise ModelError("2D detection by onnx needs a model: give --model-2d FILE.onnx or set detect2d.model")
    images = graph.add("decode images", ImageDecoder(rig, config, on_bad=on_bad), graph.frame)
    detect2d = Detect2D(rig, config, OnnxDetector2D(config.detect2d.model, config))
    return images, graph.add("detect 2D", detect2d, images)


def _nothing(_: SensorBundle) -> Decoded[Boxes2D]:
    return Decoded({})


def _propose(boxes: Boxes3D, matches: Mapping[str, Matches]) -> Hypotheses:
    return Hypotheses(boxes, matches, len(boxes))


def _collect(
    bundle: SensorBundle,
    clouds: Decoded[PointCloud],
    combined: CombinedCloud,
    lidar_boxes: Boxes3D,
    camera_data: Decoded[Any],
    camera_boxes: Mapping[str, Boxes2D],
    views: Mapping[str, CameraSensor],
    hypotheses: Hypotheses,
    fused: Fused,
) -> FrameResult:
    return FrameResult(
        bundle=bundle,
        combined=combined,
        detections=Detections(lidar=lidar_boxes, cameras=camera_boxes),
        views=views,
        hypotheses=hypotheses,
        fused=fused,
        drops=clouds.drops + camera_data.drops,
        unused_boxes=camera_data.unused_boxes,
    )


def _with_recorded(result: FrameResult, recorded: Decoded[Boxes3D]) -> FrameResult:
    return replace(result, drops=result.drops + recorded.drops, unused_boxes3d=recorded.unused_boxes)
