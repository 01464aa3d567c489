"""Scenes to learn from: points in pillars of simulated sweeps, and the output that each cell should give."""

from collections.abc import Generator, Iterable
from functools import cache, partial
from typing import Literal, NamedTuple

import numpy as np

from lidcam.bags.simulator.worlds.draw import Family, random_numbers_of
from lidcam.bags.simulator.worlds.training_scenes import SWEEPS_PER_WORLD, sweep
from lidcam.pipeline.core.arrays import F32, F64, I64
from lidcam.pipeline.core.frame import SensorBundle
from lidcam.pipeline.core.settings.load import load_config
from lidcam.pipeline.detectors.pillars.decoding import box_numbers, output_cells
from lidcam.pipeline.detectors.pillars.detector import PillarPoints
from lidcam.pipeline.detectors.pillars.grid import STRIDE, Grid, pillars
from lidcam.pipeline.parallel.pool import process_pool
from lidcam.pipeline.stages.combine import Combine
from lidcam.training.examples import cloud_of, rig_of
from lidcam.training.labelled import NAMES, WORLDS, LabelledFrame, Recordings, TrueBoxes, varied

Worlds = Literal["road", "crossing", "sandbox", "all"]
"""Families of worlds to learn from; `all`: roads and crossings."""

FULL_SIZE: tuple[Worlds, ...] = ("road", "crossing", "all")

_config = cache(load_config)

GRIDS: dict[Worlds, Grid] = {
    **dict.fromkeys(FULL_SIZE, Grid(cell_m=0.32, cells=256, low_m=0.2, high_m=4.0)),
    "sandbox": Grid(cell_m=0.04, cells=192, low_m=0.02, high_m=0.5),
}
"""Grids that networks learn in."""

WRITTEN_GRIDS = GRIDS | {"sandbox": GRIDS["sandbox"].model_copy(update={"cells": 256})}
"""Grids that networks are written for."""

CLASSES: dict[Worlds, tuple[str, ...]] = {**dict.fromkeys(FULL_SIZE, NAMES), "sandbox": NAMES[:1]}

WORLDS_OF_A_ROUND, SWEEPS_OF_A_WORLD = 4, 8  # Building a world takes as long as making ten sweeps
SCENES_OF_A_ROUND = WORLDS_OF_A_ROUND * SWEEPS_OF_A_WORLD

MIN_POINTS = 5  # Points on an object that has to be found; one with fewer may be found

# The bell around a centre: its standard deviation as a share of the object's width, and at least in output cells
SIGMA_OF_WIDTH, MIN_SIGMA_CELLS = 0.35, 0.8
UNSURE = 0.9  # Its height for an object that need not be found: learned neither as there nor as not there
MIN_BOX_HEAT = 0.4  # Its minimum height in cells that also learn the box
UNLABELLED = 0.999  # Height where the truth says nothing; so near to 1 that the network learns nothing there


class Source(NamedTuple):
    """Source of scenes."""

    worlds: Worlds  # Families of worlds, which set the grid and the classes
    recordings: Recordings | None = None  # Labelled recordings; None: worlds alone
    has_worlds: bool = True  # Whether half of the scenes come from worlds if there are recordings, instead of none

    @property
    def text(self) -> str:
        """The source in Markdown."""
        if self.recordings is None:
            return f"{WORLDS} (`{self.worlds}`)"
        share = f"as many sweeps of {WORLDS} (`{self.worlds}`) and\n  " if self.has_worlds else ""
        return f"{share}frames of {self.recordings.text}"


def family_of(worlds: Worlds, number: int) -> Family:
    """Family of the world with a number; `all` takes two worlds of each family in turn."""
    both: tuple[Family, Family] = ("road", "crossing")
    return both[number // 2 % 2] if worlds == "all" else worlds


class Targets(NamedTuple):
    """The output that a network should give."""

    heat: F32  # (C, H, W) float32, 1 where the centre of an object is
    cells: I64  # (K,) places in (H, W) where the box is learned
    numbers: F32  # (K, 8) float32 `BOX_NUMBERS` there
    weights: F32  # (K,) float32 how much each counts


class Scene(NamedTuple):
    """A frame as the network takes it (see `pillars`), and its targets."""

    features: F32
    pillar: I64
    targets: Targets


def rounds(source: Source, seed: int, first: int, last: int, workers: int) -> Generator[list[Scene]]:
    """The mixed scenes of the rounds of worlds or frames from `first` up to, but not including, `last`.

    They are the same for any number of processes. Several processes make the next round ahead.
    """
    make = partial(_scenes, source)
    worlds = [range(seed + row * WORLDS_OF_A_ROUND, seed + (row + 1) * WORLDS_OF_A_ROUND) for row in range(first, last)]
    if workers == 1:
        for row, numbers in enumerate(worlds, first):
            yield _mixed(source, seed, row, map(make, numbers))
        return
    with process_pool(workers) as pool:
        waiting = [pool.map(make, numbers) for numbers in worlds[:2]]
        for row in range(first, last):
            scenes = _mixed(source, seed, row, waiting.pop(0))
            waiting += [pool.map(make, numbers) for numbers in worlds[row - first + 2 : row - first + 3]]
            yield scenes


def _mixed(source: Source, seed: int, row: int, parts: Iterable[list[Scene]]) -> list[Scene]:
    scenes = [one for part in parts for one in part]
    order = random_numbers_of(family_of(source.worlds, 0), seed, row, 1).permutation(len(scenes))
    return [scenes[place] for place in order]


def _scenes(source: Source, number: int) -> list[Scene]:
    """Sweeps of a world, or frames of recordings; turned, mirrored and stretched."""
    family, grid, found = family_of(source.worlds, number), GRIDS[source.worlds], []
    if source.recordings is not None and (not source.has_worlds or number % 2 == 1):
        draw = random_numbers_of(family, number, 3)
        frames = (source.recordings.drawn(draw) for _ in range(SWEEPS_OF_A_WORLD))
        return [Scene(*pillars(frame.position, grid), targets_of_frame(source.worlds, frame)) for frame in frames]
    for sweep_number in range(0, SWEEPS_PER_WORLD, SWEEPS_PER_WORLD // SWEEPS_OF_A_WORLD):
        position, true = scene(family, number * SWEEPS_PER_WORLD + sweep_number)
        position, true, _ = varied(position, true, random_numbers_of(family, number, sweep_number, 2))
        found.append(Scene(*pillars(position, grid), targets_of(true, grid, len(CLASSES[family]))))
    return found


def scene(family: Family, seed: int) -> tuple[F64, TrueBoxes]:
    """The points (N, 3) of a sweep as `PillarPoints` gives them, and the true objects."""
    taken = sweep(family, seed)
    config, rig = _config(family), rig_of([taken.origin])
    combined = Combine(rig, config.combine)(SensorBundle(0, 0, 0, {}), {"0": cloud_of(taken, "0")})
    points = PillarPoints(rig, config)
    names = ["truck" if name == "van" else name for name in taken.class_names]
    seen = [row for row, name in enumerate(names) if taken.point_counts[row] and name in CLASSES[family]]
    centers = taken.centers[seen].reshape(-1, 3) - np.append(points.middle_xy, 0.0)
    centers[:, 2] -= points.ground_m(combined, centers[:, :2])
    classes = np.array([CLASSES[family].index(names[row]) for row in seen], np.int64)
    counts = taken.point_counts[seen].astype(np.int64)
    return points(combined), TrueBoxes(centers, taken.sizes[seen], taken.yaws[seen], classes, counts)


def known_to(worlds: Worlds, frame: LabelledFrame) -> TrueBoxes:
    """The objects of a frame whose classes occur in these worlds."""
    return frame.true.select(frame.true.classes < len(CLASSES[worlds]))


def targets_of_frame(worlds: Worlds, frame: LabelledFrame) -> Targets:
    """The output that a network should give for a frame, and where that is unknown."""
    grid = GRIDS[worlds]
    targets, side = targets_of(known_to(worlds, frame), grid, len(CLASSES[worlds])), grid.cells // STRIDE
    along_m = (np.arange(side) + 0.5) * STRIDE * grid.cell_m - grid.half_m
    is_known = frame.is_labelled(np.stack(np.meshgrid(along_m, along_m), -1).reshape(-1, 2)).reshape(side, side)
    np.maximum(targets.heat, np.float32(UNLABELLED), out=targets.heat, where=~is_known)
    return targets


def targets_of(true: TrueBoxes, grid: Grid, classes: int) -> Targets:
    """The output that a network should give for these boxes."""
    side = grid.cells // STRIDE
    at = output_cells(true.centers, grid)
    inside = np.flatnonzero(((at >= 0) & (at < side)).all(1))
    true, at = true.select(inside), at[inside]
    sure = true.points >= MIN_POINTS
    sigma = np.maximum(SIGMA_OF_WIDTH * true.sizes[:, 1] / (STRIDE * grid.cell_m), MIN_SIGMA_CELLS)[:, None]
    along = np.arange(side)
    across = [np.exp(-0.5 * ((along - at[:, axis, None]) / sigma) ** 2) for axis in (0, 1)]
    bells = (across[1][:, :, None] * across[0][:, None, :]).astype(np.float32)
    heat = np.zeros((classes, side, side), np.float32)
    for row, name in enumerate(true.classes):
        np.maximum(heat[name], bells[row] * np.float32(1 if sure[row] else UNSURE), out=heat[name])
    best = np.concatenate([np.full((1, side, side), MIN_BOX_HEAT, np.float32), bells * sure[:, None, None]])
    own = best.argmax(0).ravel()
    cells = np.flatnonzero(own)
    own = own[cells] - 1
    cell_xy = np.column_stack([cells % side, cells // side]).astype(np.float64)
    numbers = box_numbers(true.centers[own], true.sizes[own], true.yaws[own], cell_xy, grid)
    return Targets(heat, cells, numbers.astype(np.float32), best.reshape(len(best), -1)[own + 1, cells])
