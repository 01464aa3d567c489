"""Boxes from the numbers of a network's output, where the log odds of a class have a peak."""

from typing import NamedTuple

import numpy as np

from lidcam.pipeline.core.arrays import F32, F64, I64
from lidcam.pipeline.detectors.pillars.grid import STRIDE, Grid

BOX_NUMBERS = 8
"""Numbers of each cell after those of the classes: place of the centre along x and y from the middle of the cell, in
cells; its height above the ground, metres; logarithms of length, width and height, metres; sine and cosine of the
heading."""

MAX_BOXES = 300

MAX_LOG_M = 4.0
"""Maximum absolute logarithm of a size in metres."""


class Found(NamedTuple):
    """N boxes from the middle of the grid."""

    centers: F64  # (N, 3) x, y, and height of the middle above the ground, metres
    sizes: F64  # (N, 3) length, width, height, metres
    yaws: F64  # (N,) headings, radians
    log_odds: F64  # (N,) log odds of the class
    classes: I64  # (N,) rows of the network's classes


def box_numbers(centers: F64, sizes: F64, yaws: F64, cell_xy: F64, grid: Grid) -> F64:
    """(N, 8) `BOX_NUMBERS` of boxes as in `Found`, for output cells (N, 2) given as column and row."""
    place = (centers[:, :2] + grid.half_m) / (STRIDE * grid.cell_m) - 0.5
    return np.column_stack([place - cell_xy, centers[:, 2], np.log(sizes), np.sin(yaws), np.cos(yaws)])


def output_cells(centers: F64, grid: Grid) -> F64:
    """(N, 2) column and row of the output cells that hold boxes' centres (N, 3), whole numbers."""
    return np.floor((centers[:, :2] + grid.half_m) / (STRIDE * grid.cell_m))


def boxes_of(output: F32, grid: Grid, least_log_odds: float) -> Found:
    """The boxes at the peaks, likelier ones first; equally likely boxes keep the order of their cells.

    Args:
        output: (C + 8, H, W) output of a network.
        grid: Its grid.
        least_log_odds: Lower peaks are left out.
    """
    odds, numbers = output[:-BOX_NUMBERS], output[-BOX_NUMBERS:]
    around = np.pad(odds, ((0, 0), (1, 1), (1, 1)), constant_values=-np.inf)
    rows = np.maximum(np.maximum(around[:, :-2], around[:, 1:-1]), around[:, 2:])
    highest = np.maximum(np.maximum(rows[:, :, :-2], rows[:, :, 1:-1]), rows[:, :, 2:])
    at = np.nonzero((odds >= highest) & (odds >= least_log_odds))
    order = np.argsort(-odds[at], kind="stable")[:MAX_BOXES]
    classes, row, column = (one[order] for one in at)
    dx, dy, height_m, *log_sizes, sine, cosine = numbers[:, row, column].astype(np.float64)
    place = np.column_stack([column + 0.5 + dx, row + 0.5 + dy]) * (STRIDE * grid.cell_m) - grid.half_m
    sizes = np.exp(np.clip(np.column_stack(log_sizes), -MAX_LOG_M, MAX_LOG_M))
    log_odds = odds[classes, row, column].astype(np.float64)
    return Found(np.column_stack([place, height_m]), sizes, np.arctan2(sine, cosine), log_odds, classes)
