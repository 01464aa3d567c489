"""Objects in 3D by the cameras alone: every 2D box is placed by the ground and the size of its class."""

import math
from collections.abc import Mapping, Sequence
from functools import partial

import numpy as np

from lidcam.pipeline.core.arrays import first_of_runs
from lidcam.pipeline.core.clouds import CombinedCloud
from lidcam.pipeline.core.detections import Boxes2D, Boxes3D, Source
from lidcam.pipeline.core.rig import CameraSensor, Rig
from lidcam.pipeline.core.settings.classes import ClassPrior
from lidcam.pipeline.core.settings.fuse import FuseConfig
from lidcam.pipeline.fusion.cameras.merging import merge_sightings, moments
from lidcam.pipeline.fusion.cameras.placing import Placed, Placements, SizePriors, place
from lidcam.pipeline.fusion.cameras.sightings import Noise, see
from lidcam.pipeline.fusion.found import FoundBoxes

GROUND_SIGMA = 0.25
"""Standard deviation of the ground's height, as a share of `combine.ground.distance_m`."""

GROUND_SLOPE_SIGMA = 0.008
"""Standard deviation of the slope of the ground between camera and object, rise over run."""

BEARING_SIGMA_RAD = math.radians(0.2)
"""Standard deviation of the direction of a well calibrated camera, radians; association allows for worse ones."""


class Place:
    """Objects in 3D from the 2D boxes of a frame, without lidar points but for the ground."""

    def __init__(
        self, rig: Rig, config: FuseConfig, classes: Sequence[ClassPrior], *, ground_distance_m: float
    ) -> None:
        self._site_frame = rig.site_frame
        self._ground_height_m = rig.ground_height_m or 0.0
        self._priors = SizePriors.of(classes)
        self._noise = Noise(
            pixel_px=config.pixel_sigma_px,
            outline=config.outline_sigma,
            ground_m=GROUND_SIGMA * ground_distance_m,
            ground_slope=GROUND_SLOPE_SIGMA,
            bearing_rad=BEARING_SIGMA_RAD,
        )

    def __call__(
        self, combined: CombinedCloud, boxes2d: Mapping[str, Boxes2D], views: Mapping[str, CameraSensor]
    ) -> Placed:
        """One box of source CAMERA for all sightings of an object, in order of its first camera and its score there.

        Args:
            combined: Source of the ground.
            boxes2d: By camera name.
            views: By camera name, for every camera of the rig.
        """
        sightings = see(views, boxes2d)
        out_of_view = len(FoundBoxes.of(boxes2d, tuple(views))) - len(sightings)
        stamp_ns = combined.cloud.stamp_ns
        if not len(sightings):
            none = np.zeros(0, np.int64)
            return Placed(Boxes3D.empty(stamp_ns, self._site_frame), sightings, none, Placements.zeros(), out_of_view)
        ground_m = partial(combined.ground_m, level_m=self._ground_height_m)
        placements = place(sightings, self._priors, ground_m, self._noise)
        objects, merged = merge_sightings(placements, sightings.cameras, sightings.class_ids)
        count = len(merged.xy)
        first = first_of_runs(np.maximum.accumulate(objects)).nonzero()[0]
        found = moments(merged, sightings.origin[first, :2])
        class_ids = sightings.class_ids[first]
        sizes = self._priors.mean_m[class_ids]
        missed = np.ones(count)
        np.multiply.at(missed, objects, 1.0 - sightings.scores)
        seen = np.bincount(objects, minlength=count)
        since_ns = np.zeros(count, np.int64)
        np.add.at(since_ns, objects, sightings.stamps_ns - stamp_ns)
        boxes = Boxes3D(
            stamp_ns=stamp_ns,
            frame_id=self._site_frame,
            centers=np.column_stack([found.xy, ground_m(found.xy) + sizes[:, 2] / 2]),
            sizes=sizes,
            yaws=found.yaw_rad,
            scores=(1.0 - missed).astype(np.float32),
            class_ids=class_ids.astype(np.int32),
            point_counts=np.zeros(count, np.int32),
            covariances=found.covariances,
            sources=np.full(count, Source.CAMERA.value, np.uint8),
            measured_ns=stamp_ns + since_ns // np.maximum(seen, 1),
        )
        return Placed(boxes, sightings, objects, placements, out_of_view)
