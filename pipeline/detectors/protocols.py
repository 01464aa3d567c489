"""Protocols of detection engines, which propose boxes; the stages judge scores and overlaps."""

from collections.abc import Sequence
from typing import NamedTuple, Protocol, Self

import numpy as np

from lidcam.pipeline.core.arrays import F32, F64, I64, U8
from lidcam.pipeline.core.clouds import CombinedCloud
from lidcam.pipeline.core.detections import Boxes3D, Source
from lidcam.pipeline.core.geometry.boxes import wrap_angle


class Candidates2D(NamedTuple):
    """Proposals for one image, in the engine's own order."""

    xyxy: F32  # (N, 4) float32, left, top, right, bottom in pixels of the image as given; may reach beyond it
    scores: F32  # (N,) float32 in [0, 1]
    labels: I64  # (N,) int64, row of the detector's `labels`


class Detector2D(Protocol):
    """An engine that proposes boxes in images."""

    @property
    def labels(self) -> tuple[str, ...]:
        """Names of the objects that it can find."""

    def __call__(self, images: Sequence[U8]) -> list[Candidates2D]:
        """Proposals for each image, (H, W, 3) RGB of any size, in order."""


class Candidates3D(NamedTuple):
    """Proposals for one cloud, in the engine's own order."""

    centers: F64  # (N, 3) centre of the box, metres, site frame
    sizes: F64  # (N, 3) length, width, height, metres
    yaws: F64  # (N,) radians about +z, of any turn
    scores: F64  # (N,) in [0, 1]
    # (N,) row of the configured classes, -1 for none of them; a network maps its own labels by
    # `Config.class_id_of_label`
    class_ids: I64
    point_counts: I64  # (N,) lidar points that the box was found from; zeros where unknown
    covariances: F64  # (N, 3, 3) over x, y (m^2) and yaw (rad^2); zeros where unknown
    time_offsets_ns: I64  # (N,) mean time of the points of each box, minus the cloud's stamp; zeros where unknown

    @classmethod
    def empty(cls) -> Self:
        """No proposals."""
        none = np.zeros(0, np.int64)
        return cls(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0), np.zeros(0), none, none, np.zeros((0, 3, 3)), none)

    @classmethod
    def of(cls, boxes: Boxes3D, scores: F64, combined: CombinedCloud) -> Self:
        """Boxes (N,) of a cloud as proposals, with other scores (N,)."""
        return cls(
            centers=boxes.centers,
            sizes=boxes.sizes,
            yaws=boxes.yaws,
            scores=scores,
            class_ids=boxes.class_ids.astype(np.int64),
            point_counts=boxes.point_counts.astype(np.int64),
            covariances=boxes.covariances,
            time_offsets_ns=boxes.measured_ns - combined.detection_cloud.stamp_ns,
        )

    def as_boxes(self, rows: I64, stamp_ns: int, frame_id: str, source: Source) -> Boxes3D:
        """Some of the proposals for a cloud of a stamp, in the order of `rows`, as boxes of a frame."""
        return Boxes3D(
            stamp_ns=stamp_ns,
            frame_id=frame_id,
            centers=self.centers[rows],
            sizes=self.sizes[rows],
            yaws=wrap_angle(self.yaws[rows]),
            scores=self.scores[rows].astype(np.float32),
            class_ids=self.class_ids[rows].astype(np.int32),
            point_counts=self.point_counts[rows].astype(np.int32),
            covariances=self.covariances[rows],
            sources=np.full(len(rows), source, np.uint8),
            measured_ns=stamp_ns + self.time_offsets_ns[rows],
        )


class Detector3D(Protocol):
    """An engine that proposes boxes in the combined cloud."""

    def __call__(self, combined: CombinedCloud, /) -> Candidates3D:
        """Proposals for one frame; the order of the points must not matter."""
