"""3D networks for tests: ONNX files as `lidcam train pillars` writes them, whose output is the same for all points."""

import json
from pathlib import Path
from typing import Any

import numpy as np
from onnx_files import value, write_model

from lidcam.pipeline.core.arrays import F32, F64
from lidcam.pipeline.core.clouds import CombinedCloud
from lidcam.pipeline.core.detections import Boxes3D
from lidcam.pipeline.core.rig import Rig
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.detectors.boxes import likely_boxes
from lidcam.pipeline.detectors.pillars.decoding import BOX_NUMBERS, box_numbers, output_cells
from lidcam.pipeline.detectors.pillars.detector import PillarDetector
from lidcam.pipeline.detectors.pillars.grid import FEATURES, STRIDE, Grid
from lidcam.pipeline.detectors.pillars.network import KEY

GRID = Grid(cell_m=0.5, cells=64, low_m=0.2, high_m=4.0)


def numbers_of(centers: F64, sizes: F64, yaws: F64, log_odds: F64, rows: list[int], classes: int) -> F32:
    """What a network gives that finds these boxes, places from the middle of `GRID`, and nothing else."""
    side = GRID.cells // STRIDE
    numbers = np.full((classes + BOX_NUMBERS, side, side), -9, np.float32)
    at = output_cells(centers, GRID)
    column, row = at.astype(int).T
    numbers[classes:, row, column] = box_numbers(centers, sizes, yaws, at, GRID).T
    numbers[rows, row, column] = log_odds
    return numbers


def boxes_found(sensors: Rig, config: Config, cloud: CombinedCloud) -> Boxes3D:
    """The boxes of the configured network as they are, not fitted to points."""
    found = PillarDetector(sensors, config)(cloud)
    return likely_boxes(cloud, sensors.site_frame, found, config.detect3d.min_score)


def write_pillars(path: Path, numbers: F32, found: list[dict[str, Any]], **said: object) -> Path:
    """Write a network with this output; `said` replaces parts of its metadata, or leaves it out (`metadata=None`)."""
    specs = {"classes": found, "grid": GRID.model_dump()} | said
    inputs = [value("features", ("points", len(FEATURES))), value("pillar", ("points", 1), "int64")]
    text = f"""({", ".join(inputs)}) => ({value("found", (1, *numbers.shape))}) {{
        mean = ReduceMean <axes = [0, 1], keepdims = 0> (features) nothing = Sub (mean, mean)
        found = Add (numbers, nothing)
    }}"""
    return write_model(path, text, {"numbers": numbers[None]}, {} if "metadata" in said else {KEY: json.dumps(specs)})
