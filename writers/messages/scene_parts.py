"""What scenes are made of: foxglove_msgs, as columns (`pipeline.core.ros.columns`)."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from pipeline.core.arrays import F64
from pipeline.core.geometry.box_edges import BOX_EDGES
from pipeline.core.ros.columns import Columns, Lists
from writers.messages.parts import IDENTITY, places_as_poses, time

__all__ = ["LABEL_PX", "ellipses", "entities", "labels", "opaque", "outlines", "whole_scene"]

LABEL_PX = 13.0

_EDGES = BOX_EDGES.reshape(-1)
_LINE_LOOP, _LINE_LIST = 1, 2  # LinePrimitive
_DELETE_ALL_ENTITIES = 1  # SceneEntityDeletion.ALL
_LINE = "foxglove_msgs/msg/LinePrimitive"


def whole_scene(stamp_ns: int, *drawn: Columns) -> Columns:
    """foxglove_msgs/SceneUpdate of entities that leaves nothing of the scene before it."""
    deletion = Columns("foxglove_msgs/msg/SceneEntityDeletion", timestamp=time(stamp_ns), type=_DELETE_ALL_ENTITIES)
    shown: Lists | None = None
    for part in reversed(drawn):
        shown = Lists(part, part.count, shown)
    return Columns("foxglove_msgs/msg/SceneUpdate", deletions=Lists(deletion), entities=shown)


def entities(
    ids: Sequence[str], stamp_ns: int, frame_id: str, metadata: Mapping[str, Sequence[str]], **primitives: Lists
) -> Columns:
    """foxglove_msgs/SceneEntity that stay until they are deleted; `metadata` by key, `primitives` by name."""
    n = len(ids)
    values = [value for row in zip(*metadata.values(), strict=True) for value in row]
    pairs = Columns("foxglove_msgs/msg/KeyValuePair", len(values), key=[*metadata] * n, value=values)
    return Columns(
        "foxglove_msgs/msg/SceneEntity",
        n,
        timestamp=time(stamp_ns),
        frame_id=frame_id,
        id=ids,
        metadata=Lists(pairs, len(metadata)),
        **primitives,
    )


def outlines(corners: F64, colors: Any, thickness_px: Any, *, poses: Any = IDENTITY) -> Columns:
    """foxglove_msgs/LinePrimitive: the edges of boxes.

    Args:
        corners: (N, 8, 3) in the order of `box_corners`, metres.
        colors: (N, 4) or of all.
        thickness_px: (N,) or of all.
        poses: (N, 7) where the corners are told, or of all.
    """
    return _lines(_LINE_LIST, corners, colors, thickness_px, pose=poses, indices=_edges(len(corners)))


def _edges(count: int) -> Lists:
    return Lists(np.tile(_EDGES, count), len(_EDGES))


def ellipses(points: F64, colors: Any, thickness_px: Any) -> Columns:
    """foxglove_msgs/LinePrimitive: closed lines through points (N, K, 3) of the scene."""
    return _lines(_LINE_LOOP, points, colors, thickness_px)


def _lines(kind: int, points: F64, colors: Any, thickness_px: Any, **others: Any) -> Columns:
    n, each, _ = points.shape
    return Columns(
        _LINE,
        n,
        **{"pose": IDENTITY, **others},
        type=kind,
        thickness=thickness_px,
        scale_invariant=True,
        points=Lists(points.reshape(n * each, 3), each),
        color=colors,
    )


def labels(texts: Sequence[str], places: F64, colors: Any, size_px: float = LABEL_PX) -> Columns:
    """foxglove_msgs/TextPrimitive at places (N, 3) that face the viewer."""
    return Columns(
        "foxglove_msgs/msg/TextPrimitive",
        len(texts),
        pose=places_as_poses(places),
        billboard=True,
        font_size=size_px,
        scale_invariant=True,
        color=colors,
        text=texts,
    )


def opaque(rgb: F64) -> F64:
    """(N, 4) colours that let nothing through, of (N, 3)."""
    return np.concatenate([rgb, np.ones((len(rgb), 1))], 1)
