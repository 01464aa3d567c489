"""Pairs of projected 3D boxes and 2D boxes: which are near enough to be weighed, and which are likeliest together."""

from dataclasses import dataclass

from pipeline.core.arrays import F32, F64, I64, Bools, Rows
from pipeline.fusion.assignment_kernels import best_of_pairs
from pipeline.fusion.matching.pairing_kernels import overlapping_pairs

__all__ = ["Pairs", "best_pairs", "near_pairs"]


@dataclass(frozen=True, slots=True, eq=False)
class Pairs:
    """Q pairs of a 3D box in an image and a 2D box in the same image, near enough to be weighed.

    Attributes:
        seen: (Q,) int64 row of the projected 3D boxes, rising.
        found: (Q,) int64 row of the 2D boxes of all cameras.
        iou: (Q,) float64, overlap of both.
    """

    seen: I64
    found: I64
    iou: F64

    def __len__(self) -> int:
        return len(self.seen)

    def select(self, rows: Rows) -> "Pairs":
        """The given rows (mask or indices), in that order."""
        return Pairs(self.seen[rows], self.found[rows], self.iou[rows])


def near_pairs(seen_xyxy: F32, seen_cameras: I64, found_xyxy: F32, found_cameras: I64, *, min_giou: float) -> Pairs:
    """Pairs of rectangles in the same image whose generalised IoU is large enough.

    Args:
        seen_xyxy: (P, 4) projected 3D boxes.
        seen_cameras: (P,) their cameras, rising.
        found_xyxy: (M, 4) 2D boxes, clipped to their images.
        found_cameras: (M,) their cameras, rising.
        min_giou: The least that is enough.
    """
    return Pairs(*overlapping_pairs(seen_xyxy, seen_cameras, found_xyxy, found_cameras, min_giou))


def best_pairs(pairs: Pairs, worth: F64, seen_cameras: I64) -> Bools:
    """(Q,) which pairs belong to the assignment with the largest sum of worth; each row is taken once at most.

    By Crouse's method ("On implementing 2D rectangular assignment algorithms", IEEE TAES 52(4), 2016) for each camera.

    Args:
        pairs: Q pairs.
        worth: (Q,) of each; pairs without a positive worth are not taken.
        seen_cameras: (P,) camera of each projected 3D box, rising.
    """
    columns = int(pairs.found.max(initial=-1)) + 1
    return best_of_pairs(pairs.seen, pairs.found, seen_cameras[pairs.seen], worth, len(seen_cameras), columns)
