"""Association of 3D boxes with the 2D boxes of all cameras.

Each 3D box is projected into the images, together with the uncertainty of its position and yaw. The worth of a pair is
the log likelihood ratio of both being one object against the 2D box showing something else
(`lidcam.pipeline.core.association`), by position and size, both classes, the 2D box's score, and the hidden share of
the object (`lidcam.pipeline.fusion.matching.in_view`); hidden objects are compared by their visible part as well as
the whole. In each camera the assignment with the largest sum is taken. Then each camera is assigned again, with the
position and the class by the other cameras and its direction by its other pairs
(`lidcam.pipeline.fusion.matching.agreement`), until nothing changes.
"""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from lidcam.pipeline.core.arrays import F32, F64, I64, Bools, Indices, Table, first_of_runs, pairs_of_equal
from lidcam.pipeline.core.association import (
    CALIBRATION_SIGMA_RAD,
    MAX_SIGMAS,
    MIN_GIOU,
    anywhere_variances,
    class_confusion,
    detector_variances,
    fit_ratios,
    rectangle_features,
    squared_distances,
)
from lidcam.pipeline.core.detections import Boxes2D, Boxes3D, Matches
from lidcam.pipeline.core.geometry.boxes import pair_overlaps_xyxy
from lidcam.pipeline.core.rig import CameraSensor, Rig
from lidcam.pipeline.core.settings.classes import ClassPrior
from lidcam.pipeline.fusion.assignment import assign
from lidcam.pipeline.fusion.found import FoundBoxes
from lidcam.pipeline.fusion.matching.agreement import (
    BoxBelief,
    MatchedPairs,
    agreed_with_others,
    before_matching,
    common_shifts,
    feature_jacobian,
    limited_slopes,
    prior_covariances,
    spread,
)
from lidcam.pipeline.fusion.matching.in_view import InView, hidden_parts, project_into_views
from lidcam.pipeline.fusion.projection import CameraArrays, camera_arrays

MAX_ROUNDS = 3
"""Maximum number of rounds through the cameras."""

MIN_VISIBLE = 0.02
"""Minimum visible share of an object."""

MIN_SCORE = 0.01
"""Minimum score of a 2D box."""


@dataclass(frozen=True, slots=True, eq=False)
class Pairs(Table):
    """Q pairs of a 3D box and a 2D box in the same image, within the gate."""

    seen: I64  # (Q,) int64 row of the projected 3D boxes, rising
    found: I64  # (Q,) int64 row of the 2D boxes of all cameras
    iou: F64  # (Q,) float64 overlap


class Associate:
    """Association of 3D boxes with the 2D boxes of a frame."""

    def __init__(self, rig: Rig, classes: Sequence[ClassPrior]) -> None:
        self._names = tuple(camera.name for camera in rig.cameras)
        self._confusion = class_confusion(classes)

    def __call__(
        self, boxes3d: Boxes3D, boxes2d: Mapping[str, Boxes2D], views: Mapping[str, CameraSensor]
    ) -> Mapping[str, Matches]:
        """Matches by camera name, in the rig's order; a camera without an entry in `boxes2d` has no pairs.

        Args:
            boxes3d: N boxes in the site frame.
            boxes2d: By camera name.
            views: The cameras of the rig at the times of these 2D boxes.

        Raises:
            FrameError: the 3D boxes are not in the site frame of the cameras.
        """
        cameras = tuple(views[name] for name in self._names)
        arrays = camera_arrays(cameras)
        rows3d = _rank3d(boxes3d)  # row order decides between assignments of equal value
        ranked = boxes3d.select(rows3d)
        seen = project_into_views(ranked, cameras, arrays)
        hidden, rest, depths = hidden_parts(ranked, seen, arrays.positions)
        found = FoundBoxes.of(boxes2d, self._names)
        limits = arrays.limits.astype(np.float32).take(found.cameras, 0)
        found = replace(found, xyxy=found.xyxy.clip(0, limits))  # as the projected ones are
        of_seen, of_found = pairs_of_equal(seen.cameras, found.cameras)
        iou, giou = pair_overlaps_xyxy(seen.xyxy[of_seen], found.xyxy[of_found])
        pairs = Pairs(of_seen, of_found, iou).select(giou >= MIN_GIOU)
        taken = self._taken(ranked, seen, (hidden, rest), found, pairs, arrays)
        return self._matches(rows3d, seen, (hidden, depths), found, pairs.select(taken))

    def _matches(
        self, rows3d: Indices, seen: InView, hiding: tuple[F32, F32], found: FoundBoxes, pairs: Pairs
    ) -> dict[str, Matches]:
        """The records of all cameras, with the original rows of the boxes."""
        shape = len(self._names), len(rows3d)
        projected, covered = np.full((*shape, 4), np.nan, np.float32), np.zeros(shape, np.float32)
        edges = np.zeros((*shape, 4), np.float32)
        projected[seen.cameras, rows3d[seen.rows]] = seen.xyxy
        covered[seen.cameras, rows3d[seen.rows]], edges[seen.cameras, rows3d[seen.rows]] = hiding
        cameras, in_3d = seen.cameras[pairs.seen], rows3d[seen.rows[pairs.seen]]
        order = np.lexsort([in_3d, cameras])
        table = np.array([in_3d, found.rows[pairs.found]]).T.take(order, 0)
        iou = pairs.iou.astype(np.float32)[order]
        ends = cameras[order].searchsorted(np.arange(len(self._names) + 1)).tolist()
        return {
            name: Matches(table[start:end], iou[start:end], rectangles, shares, depths)
            for name, (start, end), rectangles, shares, depths in zip(
                self._names, itertools.pairwise(ends), projected, covered, edges, strict=True
            )
        }

    def _taken(
        self,
        boxes: Boxes3D,
        seen: InView,
        hiding: tuple[F32, F32],
        found: FoundBoxes,
        pairs: Pairs,
        arrays: CameraArrays,
    ) -> Bools:
        """(Q,) which pairs are matches."""
        taken = np.zeros(len(pairs), np.bool_)
        if not len(pairs):
            return taken
        is_first = first_of_runs(pairs.seen)
        near, pairs = pairs.seen[is_first], replace(pairs, seen=np.cumsum(is_first) - 1)
        seen, (hidden, rest) = seen.select(near), (each[near] for each in hiding)
        noise, widest = detector_variances(seen.xyxy), anywhere_variances(arrays.image_sizes)[seen.cameras]
        belief = BoxBelief(prior_covariances(boxes), np.log(self._confusion).T[boxes.class_ids], self._confusion)
        others = before_matching(belief, seen.rows)
        jacobians = limited_slopes(feature_jacobian(seen.xyxy, seen.jacobian), others.covariances, widest)
        by_box = noise + spread(others.covariances, jacobians)
        differences = _differences(seen, rest, found, pairs, by_box)
        class_ids, base_worth = found.class_ids[pairs.found], self._base_worth(hidden, found, pairs)
        area_px = arrays.image_sizes.prod(1)[seen.cameras[pairs.seen]]
        focal_px = arrays.lenses.K[:, [0, 1], [0, 1]][seen.cameras]
        aim = (CALIBRATION_SIGMA_RAD * focal_px) ** 2
        shifts, aims = np.zeros_like(aim), aim
        for _ in range(MAX_ROUNDS):
            residuals = differences - (jacobians * others.shifts[:, None]).sum(2)[pairs.seen]
            shifted, variances = residuals.copy(), by_box[pairs.seen]
            shifted[:, :2] -= shifts[pairs.seen]
            variances[:, :2] += aims[pairs.seen]
            squared = squared_distances(shifted, variances)
            ratio = fit_ratios(squared, variances, area_px)
            worth = ratio + base_worth + others.log_classes[pairs.seen, class_ids]
            before, taken = taken, best_pairs(pairs, np.where(squared <= MAX_SIGMAS**2, worth, 0.0), seen.cameras)
            if (before == taken).all():
                break
            chosen = taken.nonzero()[0]
            rows = pairs.seen[chosen]
            centers = residuals[chosen, :2], by_box[rows, :2]
            shifts, aims = common_shifts(seen.cameras, aim, rows, *centers, squared[chosen])
            errors, fit = noise[rows], differences[chosen]
            errors[:, :2] += aims[rows]
            fit[:, :2] -= shifts[rows]
            matched = MatchedPairs(rows, class_ids[chosen], fit, errors, squared[chosen], jacobians[rows])
            others = agreed_with_others(belief, seen.rows, matched)
            by_box = noise + spread(others.covariances, jacobians)
        return taken

    def _base_worth(self, hidden: F32, found: FoundBoxes, pairs: Pairs) -> F64:
        """(Q,) worth of pairs by the score of the 2D box and the visible share of the object."""
        by_score = np.log(np.maximum(found.scores.astype(np.float64), MIN_SCORE))[pairs.found]
        by_visible_share = np.log(np.maximum(1 - hidden, MIN_VISIBLE))[pairs.seen]
        return np.asarray(by_score + by_visible_share + np.log(len(self._confusion)))  # else it may be of any class


def _differences(seen: InView, rest: F32, found: FoundBoxes, pairs: Pairs, variances: F64) -> F64:
    """(Q, 4) features of 2D boxes less those of the objects, or of their visible parts (P, 4) where these are nearer.

    `variances` (P, 4) are those of the features.
    """
    whole, parts, in_image = (rectangle_features(xyxy) for xyxy in (seen.xyxy, rest, found.xyxy))
    by_whole, by_part = (in_image[pairs.found] - features[pairs.seen] for features in (whole, parts))
    of_pairs = variances[pairs.seen]
    is_part = squared_distances(by_part, of_pairs) < squared_distances(by_whole, of_pairs)
    return np.where(is_part[:, None], by_part, by_whole)


def best_pairs(pairs: Pairs, worth: F64, seen_cameras: I64) -> Bools:
    """(Q,) which pairs belong to the assignment with the largest sum of positive worth (Q,); each row at most once.

    `seen_cameras` (P,) is the camera of each projected 3D box, rising.
    """
    taken = np.asarray(worth > 0)
    good = taken.nonzero()[0]
    seen, found = pairs.seen[good], pairs.found[good]
    is_rival = (np.bincount(seen)[seen] > 1) | (np.bincount(found)[found] > 1)
    rivals = good[is_rival]
    if not len(rivals):
        return taken
    for group in np.split(rivals, np.flatnonzero(np.diff(seen_cameras[pairs.seen[rivals]])) + 1):
        rows, row = np.unique(pairs.seen[group], return_inverse=True)
        columns, column = np.unique(pairs.found[group], return_inverse=True)
        table = np.zeros((len(rows), len(columns)))
        table[row, column] = worth[group]
        is_best = np.zeros(table.shape, np.bool_)
        is_best[assign(-table)] = True
        taken[group] = is_best[row, column]
    return taken


def _rank3d(boxes: Boxes3D) -> Indices:
    """Rows by falling score, then by all other fields that matter here."""
    order = np.argsort(-boxes.scores, kind="stable")
    if first_of_runs(boxes.scores[order]).all():
        return order
    upper = boxes.covariances[:, [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]]
    return np.lexsort([*upper.T, boxes.class_ids, boxes.yaws, *boxes.sizes.T, *boxes.centers.T, -boxes.scores])
