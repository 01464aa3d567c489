"""Parts that many messages have, and scenes of foxglove_msgs."""

from collections.abc import Iterable, Mapping, Sequence
from itertools import chain, islice
from typing import Any

import numpy as np

from lidcam.pipeline.core.arrays import F64, Array
from lidcam.pipeline.core.detections import Boxes3D
from lidcam.pipeline.core.geometry.box_edges import BOX_EDGES
from lidcam.pipeline.core.ros.messages import ROS2

LABEL_PX = 13.0

_EDGES = BOX_EDGES.reshape(-1).astype(np.uint32)
LINE_STRIP, LINE_LOOP, _LINE_LIST = 0, 1, 2  # LinePrimitive
_DELETE_ALL_ENTITIES = 1  # SceneEntityDeletion.ALL


def points(numbers: F64) -> list[Any]:
    """geometry_msgs/Point of each row (N, 3)."""
    return ROS2.rows_of_numbers("geometry_msgs/msg/Point", numbers)


def vectors(numbers: F64) -> list[Any]:
    """geometry_msgs/Vector3 of each row (N, 3)."""
    return ROS2.rows_of_numbers("geometry_msgs/msg/Vector3", numbers)


def colors(rgba: F64, msgtype: str = "foxglove_msgs/msg/Color") -> list[Any]:
    """Colours of rows (N, 4): red, green, blue and opacity in [0, 1]."""
    return ROS2.rows_of_numbers(msgtype, rgba)


def box_poses(boxes: Boxes3D) -> list[Any]:
    """geometry_msgs/Pose of each box: its centre and heading."""
    turns = np.zeros((len(boxes), 4))
    turns[:, 2], turns[:, 3] = np.sin(boxes.yaws / 2), np.cos(boxes.yaws / 2)
    orientations = ROS2.rows_of_numbers("geometry_msgs/msg/Quaternion", turns)
    return ROS2.rows("geometry_msgs/msg/Pose", len(boxes), position=points(boxes.centers), orientation=orientations)


def places_as_poses(places: F64) -> list[Any]:
    """geometry_msgs/Pose of places (N, 3) without rotation."""
    no_turn = ROS2.new("geometry_msgs/msg/Quaternion", 0.0, 0.0, 0.0, 1.0)
    return ROS2.rows("geometry_msgs/msg/Pose", len(places), position=points(places), orientation=no_turn)


def split(items: Sequence[Any], counts: Array | Iterable[int]) -> list[list[Any]]:
    """The items in lists of a given length."""
    left = iter(items)
    return [list(islice(left, count)) for count in (counts.tolist() if isinstance(counts, np.ndarray) else counts)]


def whole_scene(stamp_ns: int, *drawn: Sequence[Any]) -> Any:
    """foxglove_msgs/SceneUpdate of entities that leaves nothing of the scene before it."""
    deletion = ROS2.new("foxglove_msgs/msg/SceneEntityDeletion", ROS2.time(stamp_ns), _DELETE_ALL_ENTITIES, "")
    return ROS2.new("foxglove_msgs/msg/SceneUpdate", [deletion], [*chain(*drawn)])


def entities(
    ids: Sequence[str],
    stamp_ns: int,
    frame_id: str,
    metadata: Mapping[str, Sequence[str]],
    **primitives: Sequence[Sequence[Any]],
) -> list[Any]:
    """N foxglove_msgs/SceneEntity that stay until deleted, with metadata (N,) by key and N lists of each primitive."""
    pair = "foxglove_msgs/msg/KeyValuePair"
    return ROS2.rows(
        "foxglove_msgs/msg/SceneEntity",
        len(ids),
        timestamp=ROS2.time(stamp_ns),
        frame_id=frame_id,
        id=[*ids],
        metadata=[
            [ROS2.new(pair, key, value) for key, value in zip(metadata, row, strict=True)]
            for row in zip(*metadata.values(), strict=True)
        ],
        **primitives,
    )


def outlines(corners: F64, rgba: F64, thickness_px: Any, *, poses: Any = None) -> list[Any]:
    """foxglove_msgs/LinePrimitive: the edges of boxes.

    Args:
        corners: (N, 8, 3) in the order of `box_corners`, metres.
        rgba: (N, 4), or (4,) of all.
        thickness_px: (N,) or of all.
        poses: (N,) frames of the corners; None: the corners are in the scene's frame.
    """
    return lines(_LINE_LIST, corners, rgba, thickness_px, poses=poses, indices=[_EDGES] * len(corners))


def lines(
    kind: int, places: Sequence[F64] | F64, rgba: F64, thickness_px: Any, *, poses: Any = None, **others: Any
) -> list[Any]:
    """foxglove_msgs/LinePrimitive: open or closed lines through points (K, 3) of the scene each."""
    n = len(places)
    return ROS2.rows(
        "foxglove_msgs/msg/LinePrimitive",
        n,
        pose=poses or ROS2.pose((0.0, 0.0, 0.0)),
        type=kind,
        thickness=thickness_px,
        scale_invariant=True,
        points=split(points(np.concatenate([np.zeros((0, 3)), *places])), map(len, places)),
        color=colors(np.broadcast_to(rgba, (n, 4))),
        **others,
    )


def labels(texts: Sequence[str], places: F64, rgba: F64) -> list[Any]:
    """foxglove_msgs/TextPrimitive at places (N, 3) that face the viewer."""
    return ROS2.rows(
        "foxglove_msgs/msg/TextPrimitive",
        len(texts),
        pose=places_as_poses(places),
        billboard=True,
        font_size=LABEL_PX,
        scale_invariant=True,
        color=colors(np.broadcast_to(rgba, (len(texts), 4))),
        text=[*texts],
    )


def opaque(rgb: Any) -> F64:
    """(N, 4) colours that let nothing through, of (N, 3); (4,) of one."""
    rgb = np.asarray(rgb, np.float64)
    return np.concatenate([rgb, np.ones((*rgb.shape[:-1], 1))], -1)
