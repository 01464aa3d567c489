"""The part of a large image where people are far away, shown to the network once more in its own size.

Scaled down to the pixels that a network may be given, a large image shows people at the end of the working range in too
few pixels; given in full it takes several times as long, and networks miss what is large in it, as cars nearby. Far
away is a narrow band of it.
"""

from typing import NamedTuple

import numpy as np

from lidcam.pipeline.core.clouds import CombinedCloud
from lidcam.pipeline.core.rig import CameraSensor
from lidcam.pipeline.detectors.onnx.tiles import Tile, ends_at_a_seam
from lidcam.pipeline.detectors.protocols import Candidates2D

PERSON_PX = 50.0
"""Height in pixels from which YOLOX-nano finds people, on foot or riding, about as well as in larger images
(docs/research/networks.md)."""

RANGE_M = 40.0
"""Distance up to which people are to be found: the 3D network finds them as far as that."""

MIN_GAIN = 1.25
"""Minimum scale of the far part, in scales of the whole image: a smaller gain is not worth its time."""

SLOPE = 0.03
"""Slope of the ground up to which people are in the far part, beyond the ground that the lidars saw."""

STEP_PX = 32
"""Unit of the edges of the far part: networks are slower where every image has another size."""

SHARED_HEIGHTS = 1.2
"""Maximum height of boxes of the far part, in heights that are its own: what is about as high, both may find."""

AZIMUTHS, RANGES = 180, 4
"""Number of places on the ground, all around a camera, whose people are projected."""

BESIDE_SHARE = 0.1
"""Maximum distance from the image, as a share of its size, of such people: the next ones may be in it."""


class FarView(NamedTuple):
    """A part of an image that the network sees once more."""

    part: Tile  # Where it lies
    max_height_px: float  # Height of boxes in the image up to which it shows more than the whole image

    def join(self, whole: Candidates2D, far: Candidates2D, image: Tile) -> Candidates2D:
        """The proposals for an image and those for this part, which has the word on small boxes in it.

        Two looks at one thing are no two witnesses: what only one of them takes for a person is rarely one. What ends
        where the part ends within the image is nearby, and whole in the image.
        """
        left, top, right, bottom = self.part
        xyxy = far.xyxy + np.array([left, top] * 2, np.float32)
        is_small = xyxy[:, 3] - xyxy[:, 1] <= self.max_height_px * SHARED_HEIGHTS
        kept_far = is_small & ~ends_at_a_seam(xyxy, self.part, image)
        centers = (whole.xyxy[:, :2] + whole.xyxy[:, 2:]) / 2
        is_inside = ((centers >= (left, top)) & (centers <= (right, bottom))).all(1)
        kept = ~is_inside | (whole.xyxy[:, 3] - whole.xyxy[:, 1] > self.max_height_px)
        return Candidates2D(
            np.concatenate([whole.xyxy[kept], xyxy[kept_far]]),
            np.concatenate([whole.scores[kept], far.scores[kept_far]]),
            np.concatenate([whole.labels[kept], far.labels[kept_far]]),
        )


def far_view(
    camera: CameraSensor, combined: CombinedCloud, *, person_m: float, level_m: float, max_px: int
) -> FarView | None:
    """The part of a camera's image that shows people who are too small in the whole image, up to `RANGE_M` away.

    Args:
        camera: The camera, at the frame's time.
        combined: The cloud of the frame, whose ground is taken.
        person_m: Height of a person.
        level_m: Z of the ground in the site frame where none was found.
        max_px: Pixels that the network is given at most, of the whole image and again of this part.

    Returns:
        None where people are large enough as far as that, or a part would hardly be larger.
    """
    model = camera.model
    whole = min((max_px / (model.width_px * model.height_px)) ** 0.5, 1.0)
    near_m = float(model.K[1, 1]) * person_m * whole / PERSON_PX
    if near_m >= RANGE_M or whole * MIN_GAIN > 1:
        return None
    azimuth = np.linspace(0, 2 * np.pi, AZIMUTHS, endpoint=False)[:, None, None]
    range_m = np.geomspace(near_m, RANGE_M, RANGES)[None, :, None]
    center = camera.T_camera_site.inverse().translation
    xy = center[:2] + np.stack(np.broadcast_arrays(np.cos(azimuth) * range_m, np.sin(azimuth) * range_m), -1)
    z = combined.ground_m(xy, level_m=level_m) + np.array([0, person_m]) + np.array([-SLOPE, SLOPE]) * range_m
    points = np.concatenate([np.broadcast_to(xy, (*z.shape, 2)), z[..., None]], -1).reshape(-1, 3)
    pixels, valid = model.project(camera.T_camera_site.apply(points))
    size_px = np.array([model.width_px, model.height_px])
    is_near = ((pixels >= -BESIDE_SHARE * size_px) & (pixels <= (1 + BESIDE_SHARE) * size_px)).all(1)
    seen = pixels[valid & is_near]
    if not len(seen):
        return None
    corners = np.array([np.floor(seen.min(0) / STEP_PX), np.ceil(seen.max(0) / STEP_PX)]) * STEP_PX
    (left, top), (right, bottom) = corners.clip(0, size_px).astype(int).tolist()
    area_px = (right - left) * (bottom - top)
    if not area_px or min((max_px / area_px) ** 0.5, 1.0) < MIN_GAIN * whole:
        return None
    return FarView(Tile(left, top, right, bottom), PERSON_PX / whole)
