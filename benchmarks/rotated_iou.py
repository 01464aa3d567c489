"""IoU of rotated boxes: frames of 30 x 30 boxes in lidcam, against shapely and a plain loop over pairs.

    python benchmarks/rotated_iou.py [--rounds 5] [--frames 200]

All run over the same boxes, alternating, in one process. Prints the median of microseconds for each pair that is near,
which all of them compare, and of its ratio to lidcam's, and what 10,000 such frames would take.
"""

import argparse
import statistics
import time
from collections.abc import Callable, Sequence

import numpy as np
import shapely

from pipeline.core.arrays import F64, Indices
from pipeline.core.geometry.boxes import box_corners
from pipeline.core.geometry.rotated_iou import BoxArrays, ious, pair_ious

BOXES = 30
FRAMES = 10_000
Frame = tuple[BoxArrays, BoxArrays]


def frame_of(rng: np.random.Generator) -> Frame:
    """Truth on 80 m x 80 m, and what was found of it."""
    centers = np.column_stack([rng.uniform(-40, 40, (BOXES, 2)), np.ones(BOXES)])
    truth = BoxArrays(centers, rng.uniform([3, 1.5, 1.4], [6, 2.2, 2.5], (BOXES, 3)), rng.uniform(-3, 3, BOXES))
    found = BoxArrays(centers + rng.normal(0, 0.3, centers.shape), truth.sizes, truth.yaws + rng.normal(0, 0.1, BOXES))
    return truth, found


def near_pairs(frame: Frame) -> tuple[Indices, Indices]:
    """Rows of the pairs whose circumscribed circles meet."""
    first, second = frame
    reach_m = [np.hypot(boxes.sizes[:, 0], boxes.sizes[:, 1]) / 2 for boxes in frame]
    gap_m = np.linalg.norm(first.centers[:, None, :2] - second.centers[None, :, :2], axis=-1)
    rows, columns = np.nonzero(gap_m <= reach_m[0][:, None] + reach_m[1])
    return rows, columns


def by_shapely(frame: Frame) -> F64:
    """Bird's eye IoU of the near pairs, by shapely's functions of arrays."""
    rows, columns = near_pairs(frame)
    a, b = (shapely.polygons(box_corners(*boxes)[:, :4, :2]) for boxes in frame)
    shared = shapely.area(shapely.intersection(a[rows], b[columns]))
    return np.asarray(shared / (shapely.area(a)[rows] + shapely.area(b)[columns] - shared))


def by_loop(frame: Frame) -> F64:
    """The same, each pair clipped by itself (Sutherland and Hodgman)."""
    first, second = ([corners[:4, :2].tolist() for corners in box_corners(*boxes)] for boxes in frame)
    areas = [boxes.sizes[:, 0] * boxes.sizes[:, 1] for boxes in frame]
    found = []
    for i, j in zip(*near_pairs(frame), strict=True):
        polygon = first[i]
        for start, end in zip(second[j], second[j][1:] + second[j][:1], strict=True):
            polygon = clipped(polygon, start, end)
        shared = sum(x * next_y - next_x * y for (x, y), (next_x, next_y) in turns(polygon)) / 2
        found.append(shared / (areas[0][i] + areas[1][j] - shared))
    return np.array(found)


def turns(polygon: Sequence[list[float]]) -> list[tuple[list[float], list[float]]]:
    """The edges of a polygon."""
    return list(zip(polygon, [*polygon[1:], *polygon[:1]], strict=True))


def clipped(polygon: Sequence[list[float]], start: list[float], end: list[float]) -> list[list[float]]:
    """The part of a polygon to the left of a line."""
    kept: list[list[float]] = []
    for here, there in turns(polygon):
        side, next_side = (
            (end[0] - start[0]) * (point[1] - start[1]) - (end[1] - start[1]) * (point[0] - start[0])
            for point in (here, there)
        )
        if side >= 0:
            kept.append(here)
        if side * next_side < 0:
            share = side / (side - next_side)
            kept.append([here[0] + share * (there[0] - here[0]), here[1] + share * (there[1] - here[1])])
    return kept


def by_batch(frames: Sequence[Frame]) -> F64:
    """Lidcam's, the near pairs of all frames at once."""
    pairs = [near_pairs(frame) for frame in frames]
    first, second = (
        BoxArrays(
            *(
                np.concatenate([frame[side][part][rows[side]] for frame, rows in zip(frames, pairs, strict=True)])
                for part in range(3)
            )
        )
        for side in (0, 1)
    )
    return pair_ious(first, second).bev


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--frames", type=int, default=200)
    arguments = parser.parse_args()
    rng = np.random.default_rng(0)
    frames = [frame_of(rng) for _ in range(arguments.frames)]
    near = sum(len(near_pairs(frame)[0]) for frame in frames)
    ways: dict[str, Callable[[], object]] = {
        "lidcam, frame by frame": lambda: [ious(*frame) for frame in frames],
        "lidcam, all frames at once": lambda: by_batch(frames),
        "shapely, frame by frame": lambda: [by_shapely(frame) for frame in frames],
        "loop over pairs": lambda: [by_loop(frame) for frame in frames],
    }
    seconds: dict[str, list[float]] = {name: [] for name in ways}
    for _ in range(arguments.rounds):
        for name, way in ways.items():
            started = time.perf_counter()
            way()
            seconds[name].append(time.perf_counter() - started)
    base = next(iter(ways))
    print(f"{len(frames)} frames of {BOXES} x {BOXES} boxes, {near} pairs are near")
    for name, took in seconds.items():
        middle = statistics.median(took)
        ratio = statistics.median(mine / first for mine, first in zip(took, seconds[base], strict=True))
        print(
            f"{name:27} {1e6 * middle / near:8.2f} us a pair {ratio:7.2f} x {FRAMES * middle / len(frames):8.1f} s "
            f"for {FRAMES} frames"
        )


if __name__ == "__main__":
    main()
