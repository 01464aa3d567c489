"""Association of 3D boxes with the 2D boxes of all cameras.

Each 3D box is projected into the images, together with the uncertainty of its place and yaw. A pair of a 3D and a 2D
box is worth the logarithm of how much likelier it is that both are one object than that the 2D box shows something else
(`pipeline.core.association`), by place and size, both classes, the 2D box's score, and the share of the object that
others hide (`pipeline.fusion.matching.hiding`); of a hidden object the visible part is compared as well as the whole.
In each camera the assignment with the largest sum is taken. Then each camera is looked at again with what the others
say of place and class (`pipeline.fusion.matching.agreement`), and its other pairs of how it is aimed
(`pipeline.fusion.matching.aiming`), until nothing changes.
"""

import itertools
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from pipeline.core.arrays import F32, Bools, Indices, first_of_runs
from pipeline.core.association import (
    class_confusion,
    detector_variances,
    fit_ratios,
    rectangle_features,
    squared_distances,
)
from pipeline.core.detections import Boxes2D, Boxes3D, Matches
from pipeline.core.rig import CameraSensor, Rig
from pipeline.core.settings.config import Config
from pipeline.fusion.found import FoundBoxes
from pipeline.fusion.matching.agreement import (
    BoxBelief,
    MatchedPairs,
    feature_jacobian,
    prior_covariances,
    spread,
    what_box_says,
    what_others_say,
)
from pipeline.fusion.matching.agreement_kernels import distances_of_pairs
from pipeline.fusion.matching.aiming import common_shifts
from pipeline.fusion.matching.hiding import hidden_parts
from pipeline.fusion.matching.in_view import InView, project_into_views
from pipeline.fusion.matching.pairing import Pairs, best_pairs, near_pairs
from pipeline.fusion.projection import CameraArrays, camera_arrays

__all__ = ["Associate"]

ROUNDS = 3
"""How often the cameras are asked, at most."""

LEAST_VISIBLE, LEAST_SCORE = 0.02, 0.01
"""No object counts as hidden wholly, and no 2D box as wrong for sure."""


class Associate:
    """Association of 3D boxes with the 2D boxes of a frame."""

    def __init__(self, rig: Rig, config: Config) -> None:
        self._names = tuple(camera.name for camera in rig.cameras)
        self._config = config.associate
        self._confusion = class_confusion(config.classes, config.associate.any_class)

    def __call__(
        self, boxes3d: Boxes3D, boxes2d: Mapping[str, Boxes2D], views: Mapping[str, CameraSensor]
    ) -> Mapping[str, Matches]:
        """Matches by camera name, in the rig's order; a camera without an entry in `boxes2d` has no pairs.

        Args:
            boxes3d: N boxes in the site frame.
            boxes2d: By camera name.
            views: The cameras of the rig as they stood when these boxes were measured.

        Raises:
            FrameError: the 3D boxes are not in the site frame of the cameras.
        """
        cameras = tuple(views[name] for name in self._names)
        arrays = camera_arrays(cameras)
        rows3d = _rank3d(boxes3d)  # row order decides between assignments of equal value
        ranked = boxes3d.select(rows3d)
        seen = project_into_views(ranked, cameras, arrays)
        hidden, rest = hidden_parts(ranked, seen, arrays.positions)
        found = self._found_boxes(boxes2d, arrays)
        pairs = near_pairs(seen.xyxy, seen.cameras, found.xyxy, found.cameras, min_giou=self._config.min_giou)
        taken = self._taken(ranked, seen, (hidden, rest), found, pairs, arrays)
        return self._matches(rows3d, seen, hidden, found, pairs.select(taken))

    def _found_boxes(self, boxes2d: Mapping[str, Boxes2D], arrays: CameraArrays) -> FoundBoxes:
        """The 2D boxes, clipped to the images: detected ones may reach beyond them, projected ones do not."""
        found = FoundBoxes.of(boxes2d, self._names)
        limits = arrays.limits.astype(np.float32).take(found.cameras, 0)
        return replace(found, xyxy=found.xyxy.clip(0, limits))

    def _matches(
        self, rows3d: Indices, seen: InView, hidden: F32, found: FoundBoxes, pairs: Pairs
    ) -> dict[str, Matches]:
        """The records of all cameras, with the rows of the boxes as they were given."""
        shape = len(self._names), len(rows3d)
        projected, covered = np.full((*shape, 4), np.nan, np.float32), np.zeros(shape, np.float32)
        projected[seen.cameras, rows3d[seen.rows]] = seen.xyxy
        covered[seen.cameras, rows3d[seen.rows]] = hidden
        cameras, in_3d = seen.cameras[pairs.seen], rows3d[seen.rows[pairs.seen]]
        order = np.lexsort([in_3d, cameras])
        table = np.array([in_3d, found.rows[pairs.found]]).T.take(order, 0)
        iou = pairs.iou.astype(np.float32)[order]
        ends = cameras[order].searchsorted(np.arange(len(self._names) + 1)).tolist()
        return {
            name: Matches(table[start:end], iou[start:end], rectangles, shares)
            for name, (start, end), rectangles, shares in zip(
                self._names, itertools.pairwise(ends), projected, covered, strict=True
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
        config, (hidden, rest) = self._config, hiding
        jacobians = feature_jacobian(seen.xyxy, seen.jacobian)
        focal_px = arrays.lenses.K[:, [0, 1], [0, 1]][seen.cameras]
        noise = detector_variances(seen.xyxy, config)
        aim = (np.deg2rad(config.calibration_sigma_deg) * focal_px) ** 2
        shifts, aims = np.zeros_like(aim), aim
        features = rectangle_features(np.concatenate([seen.xyxy, rest, found.xyxy]))
        in_image, class_ids = features[2 * len(seen) + pairs.found], found.class_ids[pairs.found]
        area_px = (arrays.image_sizes[:, 0] * arrays.image_sizes[:, 1])[seen.cameras[pairs.seen]]
        always = (
            np.log(np.maximum(found.scores.astype(np.float64), LEAST_SCORE))[pairs.found]
            + np.log(np.maximum(1 - hidden, LEAST_VISIBLE))[pairs.seen]
        )
        always += np.log(len(self._confusion))  # something else may be of any class
        belief = BoxBelief(prior_covariances(boxes), np.log(self._confusion).T[boxes.class_ids], self._confusion)
        others = what_box_says(belief, seen.rows)

        by_place = spread(others.covariances, jacobians)
        variances = (noise + by_place)[pairs.seen]
        differences, parts = in_image - features[pairs.seen], in_image - features[len(seen) + pairs.seen]
        visible = squared_distances(parts, variances) < squared_distances(differences, variances)
        differences = np.where(visible[:, None], parts, differences)
        for _ in range(ROUNDS):
            squared, variances, off, of_off = distances_of_pairs(
                pairs.seen, differences, jacobians, others.covariances, others.shifts, noise, shifts, aims
            )
            ratio = fit_ratios(squared, variances, area_px, config.unseen_boxes)
            worth = ratio + always + others.log_classes[pairs.seen, class_ids]
            before, taken = taken, best_pairs(pairs, np.where(squared <= config.gate**2, worth, 0.0), seen.cameras)
            if (before == taken).all():
                break
            chosen = np.flatnonzero(taken)
            rows = pairs.seen[chosen]
            shifts, aims = common_shifts(seen.cameras, aim, rows, off[chosen], of_off[chosen], squared[chosen])
            errors, fit = noise[rows], differences[chosen]
            errors[:, :2] += aims[rows]
            fit[:, :2] -= shifts[rows]
            matched = MatchedPairs(rows, class_ids[chosen], fit, errors, squared[chosen], jacobians[rows])
            others = what_others_say(belief, seen.rows, matched)
        return taken


def _rank3d(boxes: Boxes3D) -> Indices:
    """Indices by falling score, then by all other fields that matter here."""
    order = np.argsort(-boxes.scores, kind="stable")
    if first_of_runs(boxes.scores[order]).all():
        return order
    upper = boxes.covariances[:, [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]]
    return np.lexsort([*upper.T, boxes.class_ids, boxes.yaws, *boxes.sizes.T, *boxes.centers.T, -boxes.scores])
