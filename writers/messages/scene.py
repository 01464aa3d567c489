"""Objects drawn in 3D: Foxglove's SceneUpdate and RViz's MarkerArray.

Each message first deletes what the one before it drew, so nothing stale stays, however long the gap between frames.
"""

from collections.abc import Sequence
from itertools import chain, compress
from typing import Any

import numpy as np

from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.detections import Boxes3D, source_names
from lidcam.pipeline.core.geometry.boxes import UNIT_CORNERS, box_corners
from lidcam.pipeline.core.ros.messages import ROS2
from lidcam.pipeline.core.tracks import NO_TRACK, Tracks
from lidcam.pipeline.core.true_boxes import TrueBoxes
from lidcam.writers.drawing import ARROW_SHARE, DrawnObjects, ground_ellipses
from lidcam.writers.messages.parts import (
    LINE_LOOP,
    LINE_STRIP,
    box_poses,
    colors,
    entities,
    labels,
    lines,
    opaque,
    outlines,
    places_as_poses,
    split,
    vectors,
    whole_scene,
)
from lidcam.writers.palette import CAMERA_ONLY, TRUTH, ZONE
from lidcam.writers.viewpoint import SceneSurvey, drawn_zones, zone_texts

ZONE_ID = "zone-"
"""Beginning of the id of a zone's entity, before its name."""

LABEL_SHARE = 0.35
"""Height of a marker's letters as a share of the height of its box: fits a street and a 1:14 model of one."""

ALPHA_STRONG, ALPHA_PLACED, ALPHA_PREDICTED, ALPHA_FAINT, ALPHA_TRAIL = 0.25, 0.15, 0.08, 0.1, 0.8
_EDGE_PX = 2.0
_LEADER_ALPHA = 0.6
_WHITE = (1.0, 1.0, 1.0, 1.0)
_ADD, _DELETE_ALL, _CUBE, _TEXT_VIEW_FACING = 0, 3, 1, 9  # visualization_msgs/Marker
_MARKER, _COLOR = "visualization_msgs/msg/Marker", "std_msgs/msg/ColorRGBA"


def scene_update(drawn: DrawnObjects, trails: Sequence[F64], places: F64, zones: Sequence[Any] = ()) -> Any:
    """foxglove_msgs/SceneUpdate: a cube per fused object, an arrow to its front, and a label unless it is faint.

    One that no lidar shows has an ellipse of one standard deviation on the ground, one with a track its trail. The id
    of its entity is that of its track: `track-12`. `places` (N, 3) are those of the labels, metres.
    """
    objects, n, fused, strong, thin = drawn.boxes, len(drawn.boxes), drawn.result.fused, drawn.strong, drawn.thin
    stamp_ns, poses, rgba = drawn.result.bundle.stamp_ns, box_poses(objects), _colors(drawn)
    edge_colors, thickness_px = opaque(rgba[:, :3]), np.where(strong & ~thin, _EDGE_PX, _EDGE_PX / 2)
    metadata = {
        "class": [drawn.class_names[class_id] for class_id in objects.class_ids.tolist()],
        "score": [f"{score:.4f}" for score in objects.scores.tolist()],
        "source": source_names(objects.sources),
        "cameras": list(map(str, fused.matched.tolist())),
        "points": list(map(str, objects.point_counts.tolist())),
        "measured_ns": list(map(str, objects.measured_ns.tolist())),
        **_of_tracks(fused.tracks),
    }
    height, lengths = objects.sizes[:, 2], drawn.arrow_lengths_m
    heads = 0.25 * ARROW_SHARE * objects.sizes[:, 0]
    arrows = ROS2.rows(
        "foxglove_msgs/msg/ArrowPrimitive",
        n,
        pose=poses,
        shaft_length=lengths - heads,
        shaft_diameter=0.06 * height,
        head_length=heads,
        head_diameter=0.15 * height,
        color=colors(np.where(strong[:, None], edge_colors, rgba)),
    )
    sizes = vectors(objects.sizes)
    cubes = ROS2.rows("foxglove_msgs/msg/CubePrimitive", n, pose=poses, size=sizes, color=colors(rgba))
    edges = outlines(UNIT_CORNERS / 2 * objects.sizes[:, None], edge_colors, thickness_px, poses=poses)
    ellipses = ground_ellipses(objects)[thin]
    around = split(lines(LINE_LOOP, ellipses, edge_colors[thin], thickness_px[thin]), thin)
    has_trail = np.array([len(trail) > 0 for trail in trails], np.bool_)
    trail_colors = rgba[has_trail] * [1, 1, 1, 0] + [0, 0, 0, ALPHA_TRAIL]
    behind = split(lines(LINE_STRIP, [*compress(trails, has_trail)], trail_colors, _EDGE_PX), has_trail)
    up_to_labels = np.stack([drawn.roofs, places], 1)[strong]
    leader_colors = edge_colors[strong] * [1, 1, 1, _LEADER_ALPHA]
    leaders = split(lines(LINE_STRIP, up_to_labels, leader_colors, _EDGE_PX / 2), strong)
    texts = [*compress(drawn.labels, strong)]
    numbers = enumerate(drawn.tracks.tolist())
    ids = [f"object-{row}" if number == NO_TRACK else f"track-{number}" for row, number in numbers]
    shown_objects = entities(
        ids,
        stamp_ns,
        objects.frame_id,
        metadata,
        arrows=[[arrow] * (length > 0) for arrow, length in zip(arrows, lengths.tolist(), strict=True)],
        cubes=[[cube] for cube in cubes],
        lines=[[edge, *chain(*others)] for edge, *others in zip(edges, around, behind, leaders, strict=True)],
        texts=split(labels(texts, places[strong], np.array(_WHITE)), strong),
    )
    return whole_scene(stamp_ns, shown_objects, zones)


def zone_entities(survey: SceneSurvey, objects: Boxes3D) -> list[Any]:
    """foxglove_msgs/SceneEntity of each zone of a rig: its outline on the ground, and how many objects it has."""
    zones = survey.rig.zones
    if not zones:
        return []
    outlines_site, middles = drawn_zones(survey)
    texts = labels(zone_texts(survey.rig, objects.centers), middles, opaque(ZONE))
    return entities(
        [f"{ZONE_ID}{zone.name}" for zone in zones],
        objects.stamp_ns,
        survey.rig.site_frame,
        {"use": [zone.use for zone in zones]},
        lines=[[line] for line in lines(LINE_STRIP, outlines_site, opaque(ZONE), _EDGE_PX)],
        texts=[[text] for text in texts],
    )


def _of_tracks(tracks: Tracks | None) -> dict[str, list[str]]:
    """Texts of the tracks of objects for the viewer; empty for objects without one."""
    if tracks is None:
        return {}
    columns = {
        "track": map(str, tracks.ids.tolist()),
        "speed_m_s": ("" if speed_m_s != speed_m_s else f"{speed_m_s:.2f}" for speed_m_s in tracks.speeds.tolist()),
        "existence": (f"{existence:.4f}" for existence in tracks.existence.tolist()),
        "age_s": (f"{age_s:.2f}" for age_s in tracks.ages_s.tolist()),
    }
    has_track = (tracks.ids != NO_TRACK).tolist()
    return {
        name: [text if shown else "" for text, shown in zip(texts, has_track, strict=True)]
        for name, texts in columns.items()
    }


def _colors(drawn: DrawnObjects) -> F64:
    """(N, 4) red, green, blue and opacity of each object."""
    alphas = np.where(drawn.thin, ALPHA_PLACED, ALPHA_STRONG)
    alphas[~drawn.strong] = ALPHA_FAINT
    alphas[drawn.predicted] = ALPHA_PREDICTED
    return np.concatenate([drawn.colors, alphas[:, None]], 1)


def marker_array(drawn: DrawnObjects) -> Any:
    """visualization_msgs/MarkerArray: DELETEALL, then for each fused object a cube and a label facing the viewer.

    The namespace of a cube names the source of its geometry, `objects/lidar`, `objects/camera`, `objects/both` or
    `objects/predicted`, so that each of them can be hidden. Ids are the numbers of the tracks; where tracks are known,
    an object without one has a negative id.
    """
    objects, n, result = drawn.boxes, len(drawn.boxes), drawn.result
    header, white = ROS2.header(result.bundle.stamp_ns, objects.frame_id), ROS2.new(_COLOR, *_WHITE)
    numbers, rows = drawn.tracks, np.arange(n)
    ids = rows if result.fused.tracks is None else np.where(numbers != NO_TRACK, numbers, -1 - rows)
    unit, origin = ROS2.vector(1.0, 1.0, 1.0), ROS2.pose((0.0, 0.0, 0.0))
    delete = ROS2.rows(_MARKER, 1, header=header, type=_CUBE, action=_DELETE_ALL, pose=origin, scale=unit, color=white)
    letters = objects.sizes * [0.0, 0.0, LABEL_SHARE]
    above_roofs = objects.centers + objects.sizes * [0.0, 0.0, 0.5 + LABEL_SHARE]  # as far as the letters need
    cubes = ROS2.rows(
        _MARKER,
        n,
        header=header,
        ns=[f"objects/{source}" for source in source_names(objects.sources)],
        id=ids,
        type=_CUBE,
        action=_ADD,
        pose=box_poses(objects),
        scale=vectors(objects.sizes),
        color=colors(_colors(drawn), _COLOR),
    )
    texts = ROS2.rows(
        _MARKER,
        n,
        header=header,
        ns="labels",
        id=ids,
        type=_TEXT_VIEW_FACING,
        action=_ADD,
        pose=places_as_poses(above_roofs),
        scale=vectors(letters),
        color=white,
        text=[*drawn.labels],
    )
    return ROS2.new("visualization_msgs/msg/MarkerArray", [*delete, *chain(*zip(cubes, texts, strict=True))])


PLACED = "/cameras/detections"
PLACED_SCENE = "/cameras/scene"
"""Topics of the boxes that the cameras alone place; they have a message where a camera has 2D boxes."""

PLACED_EDGE_PX, TRUTH_EDGE_PX = 1.0, 1.5
ROOF_SHARE = 0.6
"""Height of a label above the centre, as a share of the height of the box: just above its roof."""


def truth_scene_topic(topic: str) -> str:
    """Topic on which the objects of a topic of truth are drawn."""
    return f"{topic}/scene"


def placed_scene(boxes: Boxes3D, class_names: Sequence[str], *, stamp_ns: int) -> Any:
    """foxglove_msgs/SceneUpdate: edges, class and score of each box, and an ellipse of one standard deviation."""
    names, scores = [class_names[class_id] for class_id in boxes.class_ids.tolist()], boxes.scores.tolist()
    color = opaque(CAMERA_ONLY)
    edges = outlines(UNIT_CORNERS / 2 * boxes.sizes[:, None], color, PLACED_EDGE_PX, poses=box_poses(boxes))
    around = lines(LINE_LOOP, ground_ellipses(boxes), color, PLACED_EDGE_PX)
    texts = [f"{name} {score:.2f}" for name, score in zip(names, scores, strict=True)]
    drawn = entities(
        [f"placed-{row}" for row in range(len(boxes))],
        stamp_ns,
        boxes.frame_id,
        {"class": names, "score": [f"{score:.4f}" for score in scores]},
        lines=[[*pair] for pair in zip(edges, around, strict=True)],
        texts=[[text] for text in labels(texts, boxes.centers + boxes.sizes * [0.0, 0.0, ROOF_SHARE], color)],
    )
    return whole_scene(stamp_ns, drawn)


def truth_scene(truth: TrueBoxes) -> Any:
    """foxglove_msgs/SceneUpdate: the edges of every object's box, in the colour of the truth.

    A click tells its class: labels would cover those of the objects.
    """
    color = opaque(TRUTH)
    corners = box_corners(truth.centers, truth.sizes, truth.yaws)
    drawn = entities(
        [f"truth-{row}" for row in range(len(truth.labels))],
        truth.stamp_ns,
        truth.frame_id,
        {"class": truth.labels},
        lines=[[edges] for edges in outlines(corners, color, TRUTH_EDGE_PX)],
    )
    return whole_scene(truth.stamp_ns, drawn)
