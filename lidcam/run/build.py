"""From bundles to results: the stages of a frame, shared among processes; `lidcam.run.frames` makes the bundles."""

from collections.abc import Collection, Generator, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from lidcam.pipeline.core.association import class_agreement
from lidcam.pipeline.core.clouds import PointCloud
from lidcam.pipeline.core.detections import Boxes2D, Boxes3D, Detections, Hypotheses, Matches
from lidcam.pipeline.core.frame import Decoded, FrameResult, SensorBundle
from lidcam.pipeline.core.messages import Drop
from lidcam.pipeline.core.rig import CameraSensor, Rig
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.detectors.cluster.fitting import BoxFitter
from lidcam.pipeline.detectors.cluster.kinds import groups_of, knows
from lidcam.pipeline.detectors.given import LIDCAMS_OWN, GivenDetectors
from lidcam.pipeline.fusion.belief.visibility import find_visibility
from lidcam.pipeline.fusion.cameras.placing import Placed
from lidcam.pipeline.fusion.zones import select_by_zones
from lidcam.pipeline.graph import Graph, Node
from lidcam.pipeline.parallel.process import WorkerProcess
from lidcam.pipeline.parallel.run import Limits, run_parallel
from lidcam.pipeline.parallel.worker import MakeGraph
from lidcam.pipeline.stages.associate import Associate
from lidcam.pipeline.stages.believe import Believe
from lidcam.pipeline.stages.classify import Classify
from lidcam.pipeline.stages.combine import Combine
from lidcam.pipeline.stages.doubt import DoubtHeadings
from lidcam.pipeline.stages.fuse import Fuse
from lidcam.pipeline.stages.odometry import FindOdometry
from lidcam.pipeline.stages.place import Place
from lidcam.pipeline.stages.propose import Propose, Proposed
from lidcam.pipeline.stages.refine import Refine
from lidcam.pipeline.stages.reshape import Reshape
from lidcam.pipeline.stages.views import Views
from lidcam.readers.rig.sensor_topics import CLOUD
from lidcam.readers.streams.decoders import CloudDecoder, OnBadMessage
from lidcam.run.box_sources import KnownBoxes, add_boxes2d, add_boxes3d, box_source, engine_3d, network_3d
from lidcam.run.frames import RunInput, decoded_topics

CLOUD_GROWTH = 16
"""Memory of the work on a cloud, in sizes of its message, roughly."""

IMAGE_GROWTH = 3
"""The same for an image."""


def build_graph(
    config: Config, rig: Rig, known: KnownBoxes, given: GivenDetectors = LIDCAMS_OWN, *, on_bad: OnBadMessage
) -> tuple[Graph[SensorBundle], Node[FrameResult]]:
    """The stages from a bundle of undecoded messages to a frame's result; known boxes are not detected again."""
    graph, config = Graph(SensorBundle), decided(config, rig)
    # Detections of each sensor.
    clouds = graph.add_stage("decode clouds", CloudDecoder(rig, config, on_bad=on_bad), graph.frame)
    combined = graph.add_stage("combine", Combine(rig, config.combine), graph.frame, clouds)
    recorded3d, lidar = add_boxes3d(graph, config, rig, combined, known, given.in_cloud, on_bad=on_bad)
    boxes2d, riders, unknown_ids = add_boxes2d(graph, config, rig, combined, known, given.in_images, on_bad=on_bad)
    views = graph.add_stage("views", Views(rig, config.combine.motion), graph.frame)
    found2d, boxes2d = boxes2d, graph.add_stage("used 2D boxes", partial(_used, rig), boxes2d, timed=False)
    place = Place(rig, config.fuse, config.classes, ground_distance_m=config.combine.ground.distance_m)
    placed = graph.add_stage("place", place, combined, boxes2d, views)
    # Hypotheses.
    associate = Associate(rig, config.classes)
    matches = graph.add_stage("associate", associate, lidar, boxes2d, views)
    fitter = BoxFitter(rig, config.classes, config.detect3d.cluster)
    propose = Propose(rig, fitter, config.detect3d.cluster, config.classes)
    proposed = graph.add_stage("propose", propose, combined, lidar, matches, placed)
    associate_all = partial(_hypotheses, associate)
    hypotheses = graph.add_stage("associate all", associate_all, lidar, matches, proposed, boxes2d, views)
    # Class, position and existence.
    detect3d, own = config.detect3d, np.arange(len(config.classes))
    groups = groups_of(config.classes) if detect3d.is_learned or detect3d.engine == "combined" else own
    tells_class = detect3d.scores_are_probabilities
    classify = Classify(config.classes, riders, score_groups=groups if tells_class else None)
    hypotheses = graph.add_stage("classify", classify, hypotheses, boxes2d)
    reshape = Reshape(fitter, config.detect3d, config.classes)
    hypotheses = graph.add_stage("reshape", reshape, combined, hypotheses, lidar)
    hypotheses = graph.add_stage("refine", Refine(rig, config.fuse), hypotheses, boxes2d, views)
    hypotheses = graph.add_stage("doubt", DoubtHeadings(config.detect3d, config.classes), hypotheses)
    look = partial(find_visibility, agreement=class_agreement(config.classes, riders), unknown_ids=unknown_ids)
    visibility = graph.add_stage("visibility", look, hypotheses, boxes2d, views, combined)
    believe = Believe(
        rig,
        config.classes,
        config.combine.motion,
        scores_are_probabilities=tells_class,
        has_network=config.detect3d.has_network,
    )
    beliefs = graph.add_stage("believe", believe, hypotheses, visibility, graph.frame, ordered=True)
    fused = graph.add_stage("fuse", Fuse(config.fuse, class_count=len(config.classes)), hypotheses, beliefs)
    fused = graph.add_stage("zones", partial(select_by_zones, zones=rig.zones), fused)
    detections = graph.add_stage("detections", _detections, lidar, found2d, placed, timed=False)
    unused = graph.add_stage("unused", _unused, clouds, recorded3d, found2d, timed=False)
    inputs = combined, detections, views, hypotheses, beliefs, fused, unused
    result = graph.add_stage("collect", _collect, graph.frame, *inputs, timed=False)
    if config.track.mode != "none" and config.track.odometry == "auto" and rig.lidars:
        find = partial(_with_odometry, FindOdometry(), rig.site_frame)
        result = graph.add_stage("odometry", find, result, ordered=True)
    return graph, result


def decided(config: Config, rig: Rig) -> Config:
    """The settings with `detect3d.method`, `detect3d.model` and `detect3d.score` decided.

    With cameras, the belief is fitted to the geometric score of clusters; the learned one leaves more false objects
    (docs/fusion.md).
    """
    changed: dict[str, str | Path | None] = {"method": engine_3d(config), "model": network_3d(config)}
    if config.detect3d.score == "auto":
        is_learned = config.detect3d.weights or (box_source(config, rig) == "none" and knows(config.classes))
        changed["score"] = "learned" if is_learned else "geometric"
    return config.model_copy(update={"detect3d": config.detect3d.model_copy(update=changed)})


def _used(rig: Rig, boxes2d: Decoded[Boxes2D]) -> Decoded[Boxes2D]:
    used = {camera.name for camera in rig.cameras if camera.fit.is_used}
    return Decoded({name: boxes for name, boxes in boxes2d.items() if name in used})


def _hypotheses(
    associate: Associate,
    lidar: Boxes3D,
    matches: Mapping[str, Matches],
    proposed: Proposed,
    boxes2d: Mapping[str, Boxes2D],
    views: Mapping[str, CameraSensor],
) -> Hypotheses:
    """All boxes with their matches; without proposals, those of the lidars' boxes."""
    boxes = proposed.boxes
    if boxes is not lidar:
        matches = associate(boxes, boxes2d, views)
    return Hypotheses(boxes, matches, len(lidar), proposed.left_out)


def _detections(lidar: Boxes3D, boxes2d: Mapping[str, Boxes2D], placed: Placed) -> Detections:
    return Detections(lidar, boxes2d, placed.boxes if boxes2d else None)


def _unused(
    clouds: Decoded[PointCloud], recorded3d: Decoded[Boxes3D], boxes2d: Decoded[Boxes2D]
) -> tuple[tuple[Drop, ...], Mapping[str, int], Mapping[str, int]]:
    """Messages and boxes that could not be used, without the decoded data, which stays in its process."""
    drops = clouds.drops + recorded3d.drops + boxes2d.drops
    return drops, boxes2d.unused_boxes, recorded3d.unused_boxes


def _collect(*parts: Any) -> FrameResult:
    """The result of its fields in their order, of which `_unused` gives the last ones."""
    *results, unused = parts
    return FrameResult(*results, *unused)


def _with_odometry(find: FindOdometry, site_frame: str, result: FrameResult) -> FrameResult:
    recorded = result.bundle.pose_of(site_frame)
    return replace(result, odometry=find(result.combined, result.bundle.stamp_ns, recorded))


def shared_results(
    stages: tuple[Graph[SensorBundle], Node[FrameResult]],
    found: Iterator[SensorBundle],
    source: RunInput,
    *,
    make_graph: MakeGraph,
    workers: int,
    expected: int,
    started: Sequence[WorkerProcess],
) -> Generator[FrameResult, None, None]:
    """The results of about `expected` bundles, in order, by one process or at most `workers`.

    Others than this one have been `started`, and get the stages from `make_graph`.

    Raises:
        WorkerError: another process cannot be started, or dies.
    """
    if workers == 1:
        return stages[0].run(stages[1], found)
    return run_parallel(
        *stages,
        found,
        Limits(workers, 2 * workers + 1, _memory_of, source.config.limits.max_waiting_bytes),
        make_graph=make_graph,
        expected=expected,
        needed=partial(_needed, decoded=decoded_topics(source.config, source.rig)),
        started=started,
    )


def _memory_of(bundle: SensorBundle) -> int:
    """Approximate memory of the work on a frame, bytes."""
    in_work = sum(
        len(message.data) * (CLOUD_GROWTH if message.channel.msgtype in CLOUD else IMAGE_GROWTH)
        for message in bundle.messages.values()
    )
    return in_work + sum(len(message.data) for message in bundle.copied)


def _needed(bundle: SensorBundle, decoded: Collection[str]) -> SensorBundle:
    """A bundle without the data that no stage reads: messages that are not decoded keep only their stamps."""
    messages = {
        topic: message._replace(data=memoryview(message.data) if topic in decoded else b"")
        for topic, message in bundle.messages.items()
    }
    return replace(bundle, messages=messages, copied=(), truth=(), video={})
