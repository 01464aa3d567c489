"""Scenes to learn from: points in pillars of simulated sweeps, and what each cell of the output should say."""

from collections.abc import Generator
from concurrent.futures import ProcessPoolExecutor
from functools import cache, partial
from multiprocessing import get_context
from typing import NamedTuple

import numpy as np

from bags.simulator.worlds.draw import Family, random_numbers_of
from bags.simulator.worlds.training_scenes import SWEEPS_PER_WORLD, TrainingSweep, sweep
from lidcam.training.examples import cloud_of, rig_of
from pipeline.core.arrays import F32, F64, I64
from pipeline.core.clouds import CombinedCloud
from pipeline.core.frame import SensorBundle
from pipeline.core.settings.config import Config
from pipeline.core.settings.load import load_config
from pipeline.detectors.pillars.decoding import box_numbers, output_cells
from pipeline.detectors.pillars.detector import PillarPoints
from pipeline.detectors.pillars.grid import STRIDE, Grid, pillars
from pipeline.stages.combine import Combine

__all__ = [
    "CLASSES",
    "GRIDS",
    "MIN_POINTS",
    "SCENES_OF_A_ROUND",
    "WORLDS_OF_A_ROUND",
    "Scene",
    "Targets",
    "TrueBoxes",
    "rounds",
    "scene",
    "targets_of",
]

GRIDS: dict[Family, Grid] = {
    "road": Grid(cell_m=0.32, cells=256, low_m=0.2, high_m=4.0),
    "crossing": Grid(cell_m=0.32, cells=256, low_m=0.2, high_m=4.0),
    "sandbox": Grid(cell_m=0.04, cells=192, low_m=0.02, high_m=0.5),
}
CLASSES: dict[Family, tuple[str, ...]] = {
    "road": ("car", "pedestrian", "cyclist", "truck", "bus"),
    "crossing": ("car", "pedestrian", "cyclist", "truck", "bus"),
    "sandbox": ("car",),
}
"""A van counts as a truck, as it does among the classes of lidcam."""

WORLDS_OF_A_ROUND = 4
SWEEPS_OF_A_WORLD = 8
"""Building a world takes as long as ten of its sweeps."""

SCENES_OF_A_ROUND = WORLDS_OF_A_ROUND * SWEEPS_OF_A_WORLD

MIN_POINTS = 5
"""Objects of fewer points need not be found, and may be."""

LEAST_SIGMA_CELLS = 0.8
SIGMA_OF_WIDTH = 0.35
"""Standard deviation of the bell around a centre, in output cells, and as a share of the object's width."""

UNSURE = 0.9
"""Height of the bell of an object that need not be found: it is told neither that it is there nor that it is not."""

NEAR = 0.4
"""Cells where the bell is at least so high learn the box, too."""


class TrueBoxes(NamedTuple):
    """M objects with a point or more; places from the middle of the grid, heights above the ground, metres.

    Attributes:
        centers: (M, 3)
        sizes: (M, 3)
        yaws: (M,)
        classes: (M,) rows of `CLASSES`.
        points: (M,) on each.
    """

    centers: F64
    sizes: F64
    yaws: F64
    classes: I64
    points: I64


class Targets(NamedTuple):
    """What the output should say.

    Attributes:
        heat: (C, H, W) float32, 1 where the centre of an object is.
        cells: (K,) places in (H, W) where the box is learned.
        numbers: (K, 8) float32 `BOX_NUMBERS` there.
        weights: (K,) float32 how much each counts.
    """

    heat: F32
    cells: I64
    numbers: F32
    weights: F32


class Scene(NamedTuple):
    """A frame as the network takes it, and its targets; see `pillars`."""

    features: F32
    pillar: I64
    targets: Targets


def rounds(family: Family, seed: int, first: int, last: int, workers: int) -> Generator[list[Scene]]:
    """The scenes of rounds of worlds from one number to before another, mixed; the same for any number of processes.

    With several processes those of the next round are made meanwhile.
    """
    of_world = partial(_world_scenes, family)
    worlds = [range(seed + row * WORLDS_OF_A_ROUND, seed + (row + 1) * WORLDS_OF_A_ROUND) for row in range(first, last)]
    if workers == 1:
        for row, one in enumerate(worlds, first):
            yield _mixed(family, seed, row, [made for world in one for made in of_world(world)])
        return
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        waiting = [pool.map(of_world, one) for one in worlds[:2]]
        for row in range(first, last):
            scenes = [made for of_one in waiting.pop(0) for made in of_one]
            waiting += [pool.map(of_world, one) for one in worlds[row - first + 2 : row - first + 3]]
            yield _mixed(family, seed, row, scenes)


def _mixed(family: Family, seed: int, row: int, scenes: list[Scene]) -> list[Scene]:
    order = random_numbers_of(family, seed, row, 1).permutation(len(scenes))
    return [scenes[place] for place in order]


def _world_scenes(family: Family, world: int) -> list[Scene]:
    """Some sweeps of a world, turned, mirrored and stretched."""
    found = []
    for number in range(0, SWEEPS_PER_WORLD, SWEEPS_PER_WORLD // SWEEPS_OF_A_WORLD):
        position, true = scene(family, world * SWEEPS_PER_WORLD + number)
        found.append(_learnable(family, *_varied(position, true, random_numbers_of(family, world, number, 2))))
    return found


def scene(family: Family, seed: int) -> tuple[F64, TrueBoxes]:
    """The points (N, 3) of a sweep as `PillarPoints` gives them, and what is truly there."""
    taken = sweep(family, seed)
    combined, points = _frame(family, taken)
    names = ["truck" if name == "van" else name for name in taken.class_names]
    seen = [row for row, name in enumerate(names) if taken.point_counts[row] and name in CLASSES[family]]
    centers = taken.centers[seen].reshape(-1, 3) - np.append(points.middle_xy, 0.0)
    centers[:, 2] -= points.ground_m(combined, centers[:, :2])
    classes = np.array([CLASSES[family].index(names[row]) for row in seen], np.int64)
    counts = taken.point_counts[seen].astype(np.int64)
    return points(combined), TrueBoxes(centers, taken.sizes[seen], taken.yaws[seen], classes, counts)


def _frame(family: Family, taken: TrainingSweep) -> tuple[CombinedCloud, PillarPoints]:
    """The cloud of a sweep as a run combines it."""
    config, rig = _config(family), rig_of([taken])
    combined = Combine(rig, config.combine)(SensorBundle(0, 0, 0, {}), {"0": cloud_of(taken, "0")})
    return combined, PillarPoints(rig, config)


@cache
def _config(family: Family) -> Config:
    return load_config(family)


def _varied(position: F64, true: TrueBoxes, draw: np.random.Generator) -> tuple[F64, TrueBoxes]:
    """The same from another side: mirrored, turned about the middle, stretched, above ground found a little wrong."""
    mirror, angle = np.array([1.0, draw.choice([-1.0, 1.0]), 1.0]), draw.uniform(-np.pi / 4, np.pi / 4)
    size, lift_m = draw.uniform(0.93, 1.07), draw.normal(0, 0.01) * position[:, 2].max(initial=0.0)
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    change = size * turn * mirror
    lift = np.array([0, 0, lift_m])
    yaws = mirror[1] * true.yaws + angle
    return position @ change.T + lift, true._replace(
        centers=true.centers @ change.T + lift, sizes=size * true.sizes, yaws=yaws
    )


def _learnable(family: Family, position: F64, true: TrueBoxes) -> Scene:
    grid = GRIDS[family]
    return Scene(*pillars(position, grid), targets_of(true, grid, len(CLASSES[family])))


def targets_of(true: TrueBoxes, grid: Grid, classes: int) -> Targets:
    """What the output of a network should say of boxes."""
    side = grid.cells // STRIDE
    at = output_cells(true.centers, grid)
    inside = ((at >= 0) & (at < side)).all(1)
    true, at = TrueBoxes._make(part[inside] for part in true), at[inside]
    sure = true.points >= MIN_POINTS
    sigma = np.maximum(SIGMA_OF_WIDTH * true.sizes[:, 1] / (STRIDE * grid.cell_m), LEAST_SIGMA_CELLS)[:, None]
    along = np.arange(side)
    across = [np.exp(-0.5 * ((along - at[:, axis, None]) / sigma) ** 2) for axis in (0, 1)]
    bells = (across[1][:, :, None] * across[0][:, None, :]).astype(np.float32)
    heat = np.zeros((classes, side, side), np.float32)
    for row, name in enumerate(true.classes):
        np.maximum(heat[name], bells[row] * np.float32(1 if sure[row] else UNSURE), out=heat[name])
    best = np.concatenate([np.full((1, side, side), NEAR, np.float32), bells * sure[:, None, None]])
    own = best.argmax(0).ravel()
    cells = np.flatnonzero(own)
    own = own[cells] - 1
    cell_xy = np.column_stack([cells % side, cells // side]).astype(np.float64)
    numbers = box_numbers(true.centers[own], true.sizes[own], true.yaws[own], cell_xy, grid)
    return Targets(heat, cells, numbers.astype(np.float32), best.reshape(len(best), -1)[own + 1, cells])
