"""Images as networks take them: colours, scale, and where the image lies in the input."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import cv2
import numpy as np

from lidcam.pipeline.core.arrays import F32, U8, Array
from lidcam.pipeline.core.settings.detect import NetworkColors

Placement = Literal["top_left", "center", "stretched"]
"""Scaled to fit, at the top left or in the centre; or scaled to fill, and so out of shape."""

PADDING = 114
IMAGENET_MEAN, IMAGENET_DEVIATION = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)


class Place(NamedTuple):
    """Place of an image in a network's input: pixel of the input = pixel of the image * scale + offset."""

    scale: F32  # (2,) float32, in x and y
    offset: F32  # (2,) float32, pixels in x and y

    def undo(self, xyxy: F32) -> F32:
        """Boxes (N, 4) in pixels of the image, from those in pixels of the input."""
        return ((xyxy - np.tile(self.offset, 2)) / np.tile(self.scale, 2)).astype(np.float32, copy=False)


@dataclass(frozen=True, slots=True)
class Preprocessing:
    """Puts images into the input of a network."""

    colors: NetworkColors  # Order and values of the channels
    placement: Placement  # Place of an image

    def blank(self, count: int, height_px: int, width_px: int) -> F32:
        """Input (N, 3, H, W) without images."""
        batch = np.empty((count, 3, height_px, width_px), np.float32)
        batch[:] = self.grey
        return batch

    def put(self, image: U8, into: F32) -> Place:
        """Scale an image (H, W, 3), red first, into an input (3, H, W), all of which is written.

        The scaled size is cut to whole pixels at the top left, as in YOLOX, and rounded in the centre, as in YOLOv5;
        the scales are those of the whole pixels.
        """
        height, width = image.shape[:2]
        room = np.array([into.shape[2], into.shape[1]])
        exact = np.array([width, height]) * (room / [width, height]).min()
        match self.placement:
            case "stretched":
                size, offset = room, np.zeros(2, np.intp)
            case "top_left":
                size, offset = exact.astype(np.intp), np.zeros(2, np.intp)
            case "center":
                size = np.round(exact).astype(np.intp)
                offset = np.round((room - size) / 2 - 0.1).astype(np.intp)
        size = np.maximum(size, 1)
        small = cv2.resize(image, (int(size[0]), int(size[1])), interpolation=cv2.INTER_LINEAR)
        (left, top), (right, bottom) = offset, offset + size
        self._write(cv2.split(small), into[:, top:bottom, left:right])
        grey = self.grey
        for margin in (into[:, :top], into[:, bottom:], into[:, top:bottom, :left], into[:, top:bottom, right:]):
            margin[:] = grey
        return Place((size / [width, height]).astype(np.float32), offset.astype(np.float32))

    @property
    def grey(self) -> F32:
        """(3, 1, 1), what stands where no image is."""
        grey = np.empty((3, 1, 1), np.float32)
        self._write([np.full((1, 1), PADDING, np.uint8)] * 3, grey)
        return grey

    def _write(self, planes: Sequence[Array], into: F32) -> None:
        """Writes red, green and blue (H, W) to (3, H, W) as the network takes them."""
        for channel, plane in enumerate(planes[::-1] if self.colors.startswith("bgr") else planes):
            values = into[channel]
            if self.colors in ("bgr_255", "rgb_255"):
                values[:] = plane
                continue
            np.divide(plane, np.float32(255), out=values)
            if self.colors == "imagenet":
                values -= np.float32(IMAGENET_MEAN[channel])
                values /= np.float32(IMAGENET_DEVIATION[channel])
