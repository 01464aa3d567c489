"""A run, read back from its result."""

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from lidcam.pipeline.core.arrays import join_rows
from lidcam.pipeline.core.detections import Source
from lidcam.pipeline.core.errors import MessageError, RecordingError
from lidcam.pipeline.core.messages import RawMessage
from lidcam.pipeline.core.tracks import NO_TRACK
from lidcam.pipeline.evaluation.road_users import RoadUserTally
from lidcam.readers.input_file import InputFile, recorded_inputs
from lidcam.readers.messages.deserialize import deserialize_as
from lidcam.readers.messages.detections import decode_detections3d, track_ids
from lidcam.readers.messages.objects import decode_tracks
from lidcam.readers.recording import Loss
from lidcam.readers.results.result import SOURCE_TOPICS, TRACKS_TOPIC, Result, open_result
from lidcam.readers.rig.calibration import SensorSource
from lidcam.readers.rig.sensor_topics import SensorFault
from lidcam.run.box_sources import boxes_2d_words
from lidcam.run.choice import UsedSettings
from lidcam.run.effect import settings_sha256
from lidcam.run.missing import MissingSensor, SilentSpan
from lidcam.run.summary import (
    CameraCorrection,
    DropCount,
    DropSummary,
    FrameSummary,
    InputSummary,
    RunSummary,
    SensorSummary,
    TimingSummary,
    UnusedTopic,
)
from lidcam.run.warning import RunWarning
from lidcam.writers.messages.scene import ZONE_ID
from lidcam.writers.tables.objects import Objects

FUSED, SCENE, SCENE_TYPE = SOURCE_TOPICS["fused"], "/fused/scene", "foxglove_msgs/msg/SceneUpdate"
"""Topics of the fused boxes, and of the drawn objects, whose metadata complete them."""

MAX_SCENE_ITEMS = 2_000_000
"""Largest number of parts of a drawing."""


def load_result(path: Path) -> tuple[RunSummary, Objects]:
    """The summary and the objects of the run that wrote a result.

    A result has neither wall times nor the places of other outputs. `settings.name` is the line that the run printed;
    only the first damaged parts are listed, and a note counts the others.

    Raises:
        RecordingError: it cannot be read, is not a result of lidcam, or one of a version that wrote less.
        CalibrationError: its rig cannot be used.
    """
    with open_result(path) as result:
        if not result.summary:
            raise RecordingError(f"{path}: expected the summary of a run in it, found none: process the recording anew")
        users, parts = RoadUserTally(result.config, result.rig), [Objects.empty(result.rig, result.config.object_names)]
        try:
            for index, messages in enumerate(result.messages_of_frames([FUSED, TRACKS_TOPIC, SCENE])):
                one = _objects(index, messages, result)
                parts.append(one)
                if TRACKS_TOPIC in messages:
                    stamp_ns = messages[FUSED].stamp_ns
                    users.add_objects(stamp_ns, one.class_ids, one.centers, one.tracks, one.speeds, one.moving)
            summary = _summary(result, path, users)
        except (MessageError, KeyError, TypeError, ValueError) as err:
            raise RecordingError(f"{path}: is damaged, or of another version of lidcam: {err}") from err
        return summary, join_rows(*parts)


def _objects(index: int, messages: Mapping[str, RawMessage], result: Result) -> Objects:
    config, rig = result.config, result.rig
    limits = replace(config.limits, max_message_items=MAX_SCENE_ITEMS)
    found = decode_detections3d(messages[FUSED], limits=config.limits)
    drawn = deserialize_as(messages[SCENE], SCENE_TYPE, limits=limits).entities
    facts = [{pair.key: pair.value for pair in one.metadata} for one in drawn if not one.id.startswith(ZONE_ID)]
    if found.unused or len(facts) != len(found):
        raise ValueError(f"frame {index}: expected {len(found)} objects in {SCENE}, found {len(facts)}")
    n, class_ids = len(found), {name: row for row, name in enumerate(config.object_names)}
    numbers = np.maximum(track_ids(found.ids), NO_TRACK)
    motion = {name: np.full(n, np.nan) for name in ("vx", "vy", "yaw_rates", "existence", "ages_s")}
    fronts_known, moving = np.zeros((2, n), np.bool_)
    if TRACKS_TOPIC in messages:
        tracks = decode_tracks(messages[TRACKS_TOPIC], limits=config.limits).tracks
        at, rows = np.nonzero(numbers[:, None] == tracks.ids)
        of_tracks = (*tracks.motions.T, tracks.existence, tracks.ages_s)
        for column, values in zip(motion.values(), of_tracks, strict=True):
            column[at] = values[rows]
        fronts_known[at], moving[at] = tracks.fronts_known[rows], tracks.moving[rows]
    return Objects(
        frame_id=found.frame_id,
        class_names=config.object_names,
        zone_names=rig.place_names,
        frames=np.full(n, index, np.int64),
        stamps_ns=np.full(n, found.stamp_ns, np.int64),
        class_ids=np.array([class_ids[label] for label in found.labels.tolist()], np.int32),
        zones=rig.place_rows(found.centers),
        scores=found.scores,
        centers=found.centers,
        sizes=found.sizes,
        yaws=found.yaws,
        point_counts=np.array([int(one["points"]) for one in facts], np.int32),
        matched=np.array([int(one["cameras"]) for one in facts], np.int32),
        covariances=found.covariances,
        sources=np.array([Source[one["source"].upper()] for one in facts], np.uint8),
        measured_ns=np.array([int(one["measured_ns"]) for one in facts], np.int64),
        tracks=numbers,
        velocities=np.stack([motion.pop("vx"), motion.pop("vy")], 1),
        fronts_known=fronts_known,
        moving=moving,
        **motion,
    )


def _summary(result: Result, path: Path, users: RoadUserTally) -> RunSummary:
    summary: Mapping[str, Any] = result.summary
    motion, sync, more = summary["motion"], summary["sync"], summary["losses_more"]
    files = tuple(map(_input_file, recorded_inputs(result.metadata)))
    facts = ("position", "reason", "size", "messages")
    return RunSummary(
        inputs=InputSummary(
            files=files,
            changed=tuple(file.name for file in files if file.is_changed),
            messages_used=summary["messages_used"],
            copied=summary["copied"],
            unused_topics=tuple(UnusedTopic(topic, count, "") for topic, count in summary["unused_topics"].items()),
            losses=tuple(Loss(Path(one["file"]), *(one[key] for key in facts)) for one in summary["losses"]),
        ),
        frames=FrameSummary(
            count=summary["frames"],
            objects={(one["class"], one["zone"] or ""): one["count"] for one in summary["objects"]},
            sources=summary["object_sources"],
            confirmed=summary["confirmed"],
            without_boxes=summary["frames_without_boxes"],
            without_boxes3d=summary["frames_without_boxes3d"],
            compensated=motion["compensated_frames"],
            odometry=motion["frames_from_clouds"],
            odometry_predicted=motion["frames_predicted"],
            points=summary["points"],
            **sync,
        ),
        drops=DropSummary(
            messages=tuple(DropCount(**one) for one in summary["drops"]),
            boxes=summary["unused_boxes"],
            boxes3d=summary["unused_boxes3d"],
            boxes_without_object=summary["boxes_without_object"],
            objects=summary["objects_left_out"],
        ),
        sensors=SensorSummary(
            rig=result.rig,
            calibration=tuple(SensorSource(**one) for one in summary["calibration"]),
            faults=tuple(SensorFault(**one) for one in summary["faults"]),
            missing=tuple(
                MissingSensor(**{**one, "silences": tuple(SilentSpan(**span) for span in one["silences"])})
                for one in summary["missing"]
            ),
            box_source=summary["box_source"],
            box_source_3d=summary["box_source_3d"],
            motion_topics=tuple(motion["topics"]),
            corrections={name: CameraCorrection(**one) for name, one in summary["camera_corrections"].items()},
            box_words=boxes_2d_words(result.config, result.rig),
        ),
        timing=TimingSummary({}, math.nan, math.nan),
        settings=UsedSettings(result.metadata["settings"], "given"),
        settings_sha256=settings_sha256(result.config),
        notes=(*summary["notes"], *([f"{more} more damaged parts, which the result does not list"] if more else [])),
        warnings=tuple(RunWarning(**one) for one in summary["warnings"]),
        outputs=(path,),
        how_to_open={},
        road_users=users.road_users,
    )


def _input_file(facts: Mapping[str, str]) -> InputFile:
    name, size = facts["name"], facts.get("size", "")
    return InputFile(
        path=facts.get("url", name),
        name=name,
        bytes=int(size) if size.isdecimal() else None,
        sha256=facts.get("sha256"),
        is_changed="changed" in facts,
    )
