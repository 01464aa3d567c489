"""A run that checks its rig: progress, tables, and plain values of the verdicts."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from rich.console import Console

from lidcam.checks.calibration.rig_check import SCALES, RigCheck
from lidcam.cli.printing.console import print_warnings
from lidcam.cli.printing.running import ShownProgress
from lidcam.cli.printing.tables import ColumnsTable
from lidcam.cli.printing.terminal import show_line, show_table
from lidcam.pipeline.calibration.camera_error import MIN_PAIRS, MIN_TRACKS, MIN_WITNESSES, CameraError
from lidcam.pipeline.calibration.lidar_error import LidarError
from lidcam.pipeline.core.arrays import Bools
from lidcam.run.frame import Frame
from lidcam.run.frames import RunInput

VALUES = ("pitch_deg", "yaw_deg", "roll_deg", "x_m", "y_m", "z_m", "time_ms")
"""Errors of a camera: rotation about x, y, z of its optical frame, translation along them, delay of its images."""

LIDAR_VALUES = ("about_x_deg", "about_y_deg", "about_z_deg", "x_m", "y_m", "z_m")

NOT_JUDGED = "not judged"

REMEDY = "recalibrate it, or use the rig that --write-rig writes"


class CheckedRun(ShownProgress):
    """Shows the progress of a run that checks its rig.

    Attributes:
        check: The check, once the recording is open.
    """

    check: RigCheck

    def opened(self, source: RunInput) -> None:
        """Begin with the rig of the recording."""
        self.check = RigCheck(source.rig, source.config, source.compared, REMEDY)
        super().opened(source)

    def frame(self, result: Frame) -> None:
        """Check a frame."""
        self.check.add_frame(result)


def print_check(out: Console, check: RigCheck) -> None:
    """Print a check; `*` marks significant errors."""
    tree = check_tree(check)
    cameras = ColumnsTable("cameras against lidars", "camera", "pairs", "tracks", *map(_heading, VALUES))
    for name, one in tree["cameras"].items():
        cameras.add_row(name, str(one["pairs"]), str(one["tracks"]), *_cells(one["errors"]))
    headings = map(_heading, LIDAR_VALUES)
    lidars = ColumnsTable(
        "lidars against each other", "lidar", "against", "points", *headings, text_columns=("against",)
    )
    for one in tree["lidars"]:
        lidars.add_row(one["lidar"], one["against"], str(one["points"]), *_cells(one["errors"]))
    for table in (cameras, lidars):
        if table.row_count:
            out.print()
            show_table(out, table)
    if any(one.error is None and one.coarse is None for one in check.cameras):
        show_line(
            out,
            f"{NOT_JUDGED}: fewer than {MIN_PAIRS} pairs of a 2D box and a tracked box of the lidars, or fewer than "
            f"{MIN_TRACKS} tracks or {MIN_WITNESSES} of their sides; 2D boxes are recorded or come from --model-2d",
            "dim",
        )
    print_warnings(out, check.warnings)


def check_tree(check: RigCheck) -> dict[str, Any]:
    """A check as plain values, for JSON; errors are null where a sensor is not judged."""
    cameras = {
        one.camera.name: {
            "pairs": one.pair_count,
            "tracks": one.track_count,
            "errors": None if one.error is None else _tree(VALUES, one.error, one.significant),
        }
        for one in check.cameras
    }
    lidars = [
        {
            "lidar": pair.second.name,
            "against": pair.first.name,
            "points": 0 if pair.error is None else pair.error.matches,
            "errors": None if pair.error is None else _tree(LIDAR_VALUES, pair.error, pair.error.large),
        }
        for pair in check.lidars
    ]
    return {"cameras": cameras, "lidars": lidars, "warnings": [f"{warning}" for warning in check.warnings]}


def _heading(name: str) -> str:
    return name.replace("_", " ")


def _cells(errors: Mapping[str, Any] | None) -> list[str]:
    if errors is None:
        return [NOT_JUDGED]
    cells = []
    for name, one in errors.items():
        digits = 0 if name == "time_ms" else 2
        mark = "*" if one and one["is_significant"] else ""
        cells.append(f"{one['value']:+.{digits}f}±{one['sigma']:.{digits}f}{mark}" if one else "")
    return cells


def _tree(names: tuple[str, ...], error: CameraError | LidarError, significant: Bools) -> dict[str, Any]:
    scales = SCALES[: len(names)]
    columns = np.round(error.values * scales, 6), np.round(error.sigmas * scales, 6), significant
    return {
        name: {"value": float(value), "sigma": float(sigma), "is_significant": bool(is_significant)} if sigma else None
        for name, value, sigma, is_significant in zip(names, *columns, strict=True)
    }
