"""Wide or high images for networks of one size: overlapping tiles, and their boxes put together again."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from lidcam.pipeline.core.arrays import F32, U8, Bools
from lidcam.pipeline.detectors.onnx.layouts import Size
from lidcam.pipeline.detectors.protocols import Candidates2D

OVERLAP = 0.2
"""Overlap of neighbouring tiles, as a share of their length."""

SEAM_SHARE = 0.01
"""Maximum distance from an edge within the image, as a share of a tile's length, of a box that may be cut there."""

MIN_COVERED_SHARE = 0.6
"""Minimum share of a cut box that another tile's box of its class covers, for it to be left out."""


class Tile(NamedTuple):
    """Part of an image, pixels."""

    left: int
    top: int
    right: int
    bottom: int

    def cut(self, image: U8) -> U8:
        """This part of an image (H, W, 3)."""
        return np.ascontiguousarray(image[self.top : self.bottom, self.left : self.right])


def tiles_of(height_px: int, width_px: int, input_px: Size, max_px: int) -> list[Tile]:
    """The tiles of an image, side by side or one below the other; one if the input has its shape, or is larger.

    Their number comes closest to the pixels that the network may be given, and is no more than shows the image in its
    own size or is needed for its shape.

    Args:
        height_px: Height of the image.
        width_px: Its width.
        input_px: Height and width of the network's input.
        max_px: Pixels that the network may be given.
    """
    slimness = width_px * input_px[0] / (height_px * input_px[1])
    length, room_px = (width_px, input_px[1]) if slimness > 1 else (height_px, input_px[0])
    most = max(min(int(np.ceil(max(slimness, 1 / slimness) - 1e-9)), round(max_px / (input_px[0] * input_px[1]))), 1)
    sides = [min(int(np.ceil(length / (count - (count - 1) * OVERLAP))), length) for count in range(1, most + 1)]
    count = next((count for count, side in enumerate(sides, 1) if side <= room_px), most)
    side = sides[count - 1]
    starts = np.linspace(0, length - side, count).astype(int).tolist()
    if slimness > 1:
        return [Tile(start, 0, start + side, height_px) for start in starts]
    return [Tile(0, start, width_px, start + side) for start in starts]


def join_tiles(found: Sequence[Candidates2D], tiles: Sequence[Tile], *, min_score: float) -> Candidates2D:
    """The proposals for an image from those for its tiles, each in pixels of its own tile.

    What is seen in two tiles as a whole is there twice, which suppression sees to. What ends where a tile ends within
    the image is left out if another tile shows it better.

    Args:
        found: Proposals for each tile.
        tiles: Where the tiles lie.
        min_score: Proposals with a lower score are left out.
    """
    if len(tiles) == 1:
        return found[0]
    width, height = max(tile.right for tile in tiles), max(tile.bottom for tile in tiles)
    parts, may_be_cut, of_tile = [], [], []
    for row, (candidates, tile) in enumerate(zip(found, tiles, strict=True)):
        kept = candidates.scores >= min_score
        xyxy = candidates.xyxy[kept] + np.array([tile.left, tile.top, tile.left, tile.top], np.float32)
        parts.append(Candidates2D(xyxy, candidates.scores[kept], candidates.labels[kept]))
        may_be_cut.append(ends_at_a_seam(xyxy, tile, Tile(0, 0, width, height)))
        of_tile.append(np.full(len(xyxy), row))
    joined = Candidates2D(*(np.concatenate(column) for column in zip(*parts, strict=True)))
    tile_of, cut = np.concatenate(of_tile), np.flatnonzero(np.concatenate(may_be_cut))  # only these are compared: few
    may_cover = (joined.labels[cut, None] == joined.labels) & (tile_of[cut, None] != tile_of)
    whole = np.ones(len(tile_of), np.bool_)
    whole[cut] = ~(may_cover & _is_covered(joined.xyxy[cut], joined.xyxy)).any(1)
    return Candidates2D(joined.xyxy[whole], joined.scores[whole], joined.labels[whole])


def ends_at_a_seam(xyxy: F32, tile: Tile, image: Tile) -> Bools:
    """(N,) whether boxes (N, 4) found in a tile end at an edge of it that lies within the image: they may be cut."""
    inner = np.array(tile) != np.array(image)
    seam_px = SEAM_SHARE * max(tile.right - tile.left, tile.bottom - tile.top)
    outside = (xyxy - np.array(tile, np.float32)) * np.array([-1, -1, 1, 1], np.float32)
    cut: Bools = ((outside >= -seam_px) & inner).any(1)
    return cut


def _is_covered(parts: F32, others: F32) -> Bools:
    """(M, N) whether each of M boxes (M, 4) is smaller than each of N (N, 4) and lies in it for the most part."""
    part, other = parts[:, None].astype(np.float64), others.astype(np.float64)
    shared = np.minimum(part[..., 2:], other[:, 2:]) - np.maximum(part[..., :2], other[:, :2])
    common = np.prod(np.maximum(shared, 0), axis=2)
    area, areas = (np.prod(np.maximum(boxes[..., 2:] - boxes[..., :2], 0), axis=-1) for boxes in (part, other))
    covered: Bools = (common >= MIN_COVERED_SHARE * area) & (area < areas) & (area > 0)
    return covered
