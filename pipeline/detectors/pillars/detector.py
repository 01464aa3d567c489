"""The engine: a network in pillars turns points above the ground into boxes, which are fitted to their points."""

from dataclasses import replace

import numpy as np

from lidcam.pipeline.core.arrays import F32, F64, I64, Bools
from lidcam.pipeline.core.clouds import CombinedCloud
from lidcam.pipeline.core.detections import Boxes3D
from lidcam.pipeline.core.errors import ModelError
from lidcam.pipeline.core.geometry.boxes import wrap_angle
from lidcam.pipeline.core.geometry.regions import points_in_footprints
from lidcam.pipeline.core.geometry.rotated_iou import ious, pair_ious
from lidcam.pipeline.core.rig import Rig
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.detectors.boxes import likely_boxes
from lidcam.pipeline.detectors.cluster.axes import Axes, axes_of_neighbours
from lidcam.pipeline.detectors.cluster.completion import MAX_SLENDER_SHARE, Directions
from lidcam.pipeline.detectors.cluster.fitting import BoxFitter
from lidcam.pipeline.detectors.cluster.refitting import Refitter
from lidcam.pipeline.detectors.log_odds import logit, sigmoid
from lidcam.pipeline.detectors.onnx.session import OnnxSession
from lidcam.pipeline.detectors.pillars.embedded import existing_network_file
from lidcam.pipeline.detectors.pillars.kits import KEY, KitNetwork
from lidcam.pipeline.detectors.pillars.network import PillarNetwork
from lidcam.pipeline.detectors.protocols import Candidates3D

MIN_ALIKE_IOU = 0.5
"""Minimum IoU from above of two boxes of the network that are one vehicle, of which it does not know the class."""

MIN_PROBABILITY = 0.02
"""Minimum probability of a proposed box."""

MIN_FITTED_IOU = 0.25
"""Minimum IoU, seen from above, of a box and the one fitted to its points, for the fit to be taken. Of 0.2 to 0.7 about
the best in drawn worlds."""

MERGED_CORRELATION = 0.5
"""Assumed correlation of the errors of a network's box and the one fitted to its points."""

LENGTH_POINTS = 200.0
"""Number of points at which the network's length of a car has half of the weight, which rises with the number: many
points show the network the size, and rounded bumpers make a fit too short. Of 41 views of KITTI cars with 800 points
and more, the network's lengths are off by 0.22 m, and the fitted ones by 0.37 m; of 112 simulated ones by 0.19 and 0.41
m."""

WIDTH_WEIGHT = 0.7
"""Weight of the network's width of a car: the best of 3,965 boxes of cars in drawn worlds and KITTI drive 0009."""

VEHICLE_VARIANCE = 0.2
"""Variance of the position of a vehicle with many points, as a share of the one stated for its class."""

VEHICLE_POINTS = 25.0
"""Number of points at which a vehicle's variance grows by the one stated for its class.

With `VEHICLE_VARIANCE` from drawn worlds, in which cars with 8, 100 and 1,000 points are off by 0.4, 0.14 and 0.1 m;
labelled real frames agree.
"""

HEADING_VARIANCE = 0.1
"""Variance of the heading of a vehicle with many points, as a share of that of its box."""

HEADING_POINTS = 30.0
"""Number of points at which this share grows by one.

Headings of cars with 20, 50, 130 and 350 points in KITTI drive 0009 are off by 3.5, 2.5, 2.4 and 2.1 degrees (root mean
square), where their boxes state 7.6, 4.7, 3.0 and 2.0. A tenth of those with less than 80 points, whose width was taken
for the length, do not count.
"""


def merged(network: Boxes3D, fitted: Boxes3D, weights: F64) -> Boxes3D:
    """The boxes of a network, merged with those fitted to the points in them, whose directions they keep.

    Errors from the same points are not independent: place and heading are means, weighted by the information of each
    box, and the information of both is divided by one and their correlation, which is exact for equal covariances (with
    a correlation of one, this is the covariance intersection of Julier and Uhlmann, "A non-divergent estimation
    algorithm in the presence of unknown correlations", 1997).

    Args:
        network: N boxes of the network.
        fitted: Those fitted to their points.
        weights: (N, 3) weights of the network's lengths, widths and heights; z of the centre has that of the height.
    """
    network_weights, fitted_weights = (
        np.linalg.inv(boxes.covariances) / (1 + MERGED_CORRELATION) for boxes in (network, fitted)
    )
    covariances = np.asarray(np.linalg.inv(network_weights + fitted_weights), np.float64)
    turn = wrap_angle(2 * (network.yaws - fitted.yaws)) / 2
    apart = np.column_stack([network.centers[:, :2] - fitted.centers[:, :2], turn])
    moved = np.einsum("nij,njk,nk->ni", covariances, network_weights, apart)
    middles_m = fitted.centers[:, 2] + weights[:, 2] * (network.centers - fitted.centers)[:, 2]
    return replace(
        fitted,
        centers=np.column_stack([fitted.centers[:, :2] + moved[:, :2], middles_m]),
        sizes=fitted.sizes + weights * (network.sizes - fitted.sizes),
        yaws=wrap_angle(fitted.yaws + moved[:, 2]),
        covariances=covariances,
    )


def by_points(vehicles: Boxes3D) -> F64:
    """(N, 3, 3) covariances of vehicles, with the variances of position and heading scaled by the number of points."""
    points = np.maximum(vehicles.point_counts, 1)
    share = VEHICLE_VARIANCE + VEHICLE_POINTS / points
    scale = np.sqrt(np.column_stack([share, share, HEADING_VARIANCE + HEADING_POINTS / points]))
    return np.asarray(scale[:, :, None] * vehicles.covariances * scale[:, None])


class PillarPoints:
    """The points of a frame as a network takes them."""

    def __init__(self, rig: Rig, config: Config) -> None:
        self._fitter = BoxFitter(rig, config.classes, config.detect3d.cluster)
        origins = rig.lidar_xyz[:, :2]
        self.middle_xy: F64 = origins.mean(0) if len(origins) else np.zeros(2)

    def __call__(self, combined: CombinedCloud) -> F64:
        """(N, 3) x and y from the middle of the lidars, and height above the ground, metres."""
        points = self._fitter.above_ground(combined, np.arange(len(combined.detection_cloud)), -np.inf)
        return np.asarray(points.position - np.append(self.middle_xy, 0.0))

    def with_ground(self, combined: CombinedCloud) -> tuple[F64, F32]:
        """(N, 3) the same for all points, including the ground, and their intensities (N,) from 0 to 1.

        Those of a lidar are from 0 to 255 if any is above 1. Where nobody knows which lidar measured the ground, this
        is decided for all lidars together.
        """
        clouds = combined.detection_cloud, combined.ground_cloud
        position = np.concatenate([one.xyz for one in clouds]) - np.append(self.middle_xy, 0.0)
        position[:, 2] -= self.ground_m(combined, position[:, :2])
        intensity = np.concatenate([one.intensity for one in clouds])
        lidar = np.zeros(len(intensity), np.uint8)
        if combined.ground_lidar_index is not None:
            lidar = np.concatenate([combined.detection_lidar_index, combined.ground_lidar_index])
        highest = np.zeros(256, np.float32)
        np.maximum.at(highest, lidar, intensity)
        full = np.where(highest > 1, np.float32(255), np.float32(1))
        return position, np.clip(intensity / full[lidar], 0, 1)

    def ground_m(self, combined: CombinedCloud, xy: F64) -> F64:
        """(N,) height of the ground in the site frame at places (N, 2) that are relative to the middle."""
        return self._fitter.ground_m(combined, xy + self.middle_xy)


class PillarDetector:
    """Proposes the boxes that a network finds. It tells front from rear."""

    def __init__(self, rig: Rig, config: Config) -> None:
        """Load the network.

        Raises ModelError if there is none, it cannot be loaded, none of its classes is configured, or its pillars are
        wider than all those that are.
        """
        path = config.detect3d.model
        if path is None:
            raise ModelError(
                f"detect3d.method {config.detect3d.engine} needs a network: give --model-3d FILE.onnx or set "
                "detect3d.model; none for these classes comes with lidcam"
            )
        path = existing_network_file(path)
        session = OnnxSession(path, provider=config.detect3d.provider)
        make = KitNetwork if KEY in session.metadata else PillarNetwork
        self._network, self._points = make(path, session), PillarPoints(rig, config)
        found = self._network.classes
        self._class_ids = np.array([config.class_id_of_label.get(one.name.lower(), -1) for one in found])
        if (self._class_ids < 0).all():
            names = ", ".join(one.name for one in found)
            raise ModelError(f"{path}: finds {names}; expected one that is a class or a label of a class in `classes`")
        widest = max((config.classes[one] for one in self._class_ids if one >= 0), key=lambda prior: prior.size_m[1])
        if widest.size_m[1] < self._network.cell_m:
            raise ModelError(
                f"{path}: has pillars of {self._network.cell_m:g} m, expected narrower ones than the classes it finds "
                f"({widest.name} {widest.size_m[1]:g} m); take a network that was trained for this size, or another "
                "--config"
            )
        variances = [(one.sigma_m**2, one.sigma_m**2, one.sigma_rad**2) for one in found]
        self._covariances = np.array([np.diag(one) for one in variances])

    @property
    def recorded_ids(self) -> I64:
        """(M,) those of `class_ids` whose scores were calibrated in recordings."""
        is_recorded = np.array([one.recorded for one in self._network.classes])
        return np.asarray(self._class_ids[(self._class_ids >= 0) & is_recorded])

    @property
    def class_ids(self) -> I64:
        """(M,) configured classes that the network finds."""
        return self._class_ids[self._class_ids >= 0]

    def reaches(self, xy: F64) -> Bools:
        """(N,) whether places (N, 2) in the site frame are in the grid of the network."""
        return self._network.reaches(xy - self._points.middle_xy)

    def __call__(self, combined: CombinedCloud) -> Candidates3D:
        """Boxes with a point in them or within half a pillar of them, because a box may be a little too small."""
        least = float(logit(np.array(MIN_PROBABILITY)))
        if isinstance(self._network, KitNetwork):
            found = self._network(*self._points.with_ground(combined), least)
        else:
            found = self._network(self._points(combined), least)
        centers = found.centers.copy()
        centers[:, :2] += self._points.middle_xy
        centers[:, 2] += self._points.ground_m(combined, found.centers[:, :2])
        cloud, count = combined.detection_cloud, len(centers)
        footprints = found.sizes[:, :2] + self._network.cell_m
        rows, box = points_in_footprints(cloud.xyz, centers[:, :2], footprints, found.yaws)
        points = np.bincount(box, minlength=count)
        total_ns = np.bincount(box, cloud.time_offset_ns[rows], minlength=count)
        kept = np.flatnonzero(points)
        return Candidates3D(
            centers=centers[kept],
            sizes=found.sizes[kept],
            yaws=found.yaws[kept],
            scores=sigmoid(found.log_odds[kept]),
            class_ids=self._class_ids[found.classes[kept]],
            point_counts=points[kept],
            covariances=self._covariances[found.classes[kept]],
            time_offsets_ns=np.rint(total_ns[kept] / points[kept]).astype(np.int64),
        )


class FittedPillarDetector:
    """Proposes the boxes of a network, fitted to the points in them.

    The network knows where objects are and where their front is; the points in a box show its sides and its heading
    more exactly. How long a vehicle is, of which a side is seen, the network knows better. So a vehicle is merged from
    its two boxes: the more points a car has, the more its length is the network's. Vehicles around a vehicle tell its
    axis where its points hardly do.

    Attributes:
        network: The network.
    """

    def __init__(self, rig: Rig, config: Config) -> None:
        """Load the network; raises ModelError as `PillarDetector`."""
        self.network, self._site_frame = PillarDetector(rig, config), rig.site_frame
        fitter = BoxFitter(rig, config.classes, config.detect3d.cluster)
        self._refit = Refitter(fitter, config.detect3d.cluster, config.classes)
        sizes = np.array([prior.size_m for prior in config.classes])
        self._is_slender = sizes[:, 1] <= MAX_SLENDER_SHARE * sizes[:, 2]
        self._is_tall = sizes[:, 2] > sizes[self._is_slender, 2].max(initial=0)

    def __call__(self, combined: CombinedCloud) -> Candidates3D:
        """Boxes of the network, fitted to their points where the fit agrees with the network."""
        boxes = self.boxes(combined)
        return Candidates3D.of(boxes, boxes.scores.astype(np.float64), combined)

    def boxes(self, combined: CombinedCloud) -> Boxes3D:
        """Boxes as proposed, likelier ones first, without those that share the ground of a likelier one.

        Vehicles taller than people stay beside likelier people: to the network their parts may look like people.
        A box is left as it is where its points are only a part of the object, or more than the object.
        """
        proposed = self.network(combined)
        are_vehicles = (proposed.class_ids >= 0) & ~self._is_slender[proposed.class_ids]
        vehicles = Candidates3D._make(column[are_vehicles] for column in proposed)
        found, beside = (likely_boxes(combined, self._site_frame, one, 0.0) for one in (proposed, vehicles))
        found = found.select(~self._is_tall[found.class_ids]).joined(beside.select(self._is_tall[beside.class_ids]))
        found = self._as_vehicles(found.select(np.argsort(-found.scores, kind="stable")), vehicles)
        by_network = self._fitted(combined, found, Axes.unknown(len(found)))
        axes = axes_of_neighbours(by_network, ~self._is_slender[by_network.class_ids])
        return self._fitted(combined, found, axes)

    def _fitted(self, combined: CombinedCloud, found: Boxes3D, axes: Axes) -> Boxes3D:
        """Boxes of the network, merged with those fitted to their points, with the expected axes of their sides."""
        directions = Directions(found.yaws, found.covariances[:, 2, 2], axes)
        fitted, _ = self._refit(combined, found, np.arange(len(found)), directions)
        agree = pair_ious(found, fitted).bev >= MIN_FITTED_IOU
        is_slender = self._is_slender[found.class_ids]
        better = agree * np.where(is_slender, 1, 2)
        weights = np.full((len(found), 3), 0.5)  # of lengths, widths and heights
        weights[:, 0], weights[:, 1] = found.point_counts / (found.point_counts + LENGTH_POINTS), WIDTH_WEIGHT
        weights[self._is_tall[found.class_ids]] = 0.5
        both = merged(found, fitted, weights)
        boxes = found.joined(fitted, both).select(np.arange(len(found)) + len(found) * better)
        return replace(boxes, covariances=np.where(is_slender[:, None, None], boxes.covariances, by_points(boxes)))

    def _as_vehicles(self, found: Boxes3D, vehicles: Candidates3D) -> Boxes3D:
        """Boxes with the probability that a vehicle is there: a tall car may look like a van, too."""
        is_other = (ious(found, vehicles).bev > MIN_ALIKE_IOU) & (found.class_ids[:, None] != vehicles.class_ids)
        is_other &= ~self._is_slender[found.class_ids][:, None]
        other = np.where(is_other, vehicles.scores, 0.0).max(1, initial=0.0)
        return replace(found, scores=(1 - (1 - found.scores) * (1 - other)).astype(np.float32))
