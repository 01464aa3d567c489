"""Truth in images: objects in space, projected with the camera of the rig."""

import numpy as np

from pipeline.core.arrays import I32
from pipeline.core.geometry.boxes import box_corners
from pipeline.core.rig import CameraSensor
from pipeline.evaluation.evaluation_frame import UNKNOWN, TruthBoxes2D, TruthBoxes3D

__all__ = ["projected_truth"]


def projected_truth(boxes: TruthBoxes3D, camera: CameraSensor, pixels: I32 | None) -> TruthBoxes2D:
    """The objects that a camera sees, as boxes around their projections.

    An object without a pixel in the image is hidden, and left out. Where the truth counts the pixels of all images
    together, an object without any is left out, and of the others it is not known which this image shows: those whose
    projection lies in it.

    Args:
        boxes: Objects in the site frame, at the time of the image.
        camera: The camera.
        pixels: (N,) int32, pixels of this image that show each object; `UNKNOWN` or None where the truth does not say.
    """
    of_image = np.full(len(boxes), UNKNOWN, np.int32) if pixels is None else pixels
    told = np.flatnonzero(np.where(of_image == UNKNOWN, boxes.image_pixels, of_image) != 0)
    corners = box_corners(boxes.centers[told], boxes.sizes[told], boxes.yaws[told])
    xyxy = camera.model.project_boxes(camera.T_camera_site.apply(corners))
    is_seen = np.isfinite(xyxy).all(1)
    seen = told[is_seen]
    return TruthBoxes2D(
        boxes.stamp_ns,
        xyxy[is_seen],
        boxes.class_ids[seen],
        boxes.labels[seen],
        boxes.track_ids[seen],
        of_image[seen],
        boxes.is_ignored[seen],
    )
