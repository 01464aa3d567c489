"""Truth from the evaluation folder of the predecessor system: the odometry of its one car.

`odom/*.txt` has a row for each frame, the N-th for `pcd/N.txt` and `img/N/`; of several files the one with the largest
number holds all (`30000.txt`). How the system read a row was never published, so the number of columns says what it is:
3 are x, y, yaw; 4 are x, y, z, yaw; 7 are position and quaternion (x, y, z, w), or, where the last four are no
quaternion, a whole box (x, y, z, length, width, height, yaw); 13 are a pose with its velocities. Metres and radians in
the site frame. The box of the car is that of the rig's section `truth`, else that of the system's model car.
"""

from pathlib import Path

import numpy as np

from pipeline.core.arrays import F64
from pipeline.core.errors import RecordingError
from pipeline.core.geometry.rotations import matrix_of_quaternion, matrix_of_rpy
from pipeline.core.rig import Rig, TruthVehicle
from pipeline.core.settings.config import Config
from pipeline.evaluation.evaluation_frame import TruthBoxes3D
from readers.files.evaluation_folder import START_NS, STEP_NS
from readers.truth.boxes import (
    MAX_OFF_UNIT,
    Labelled,
    class_ids_of_labels,
    label_files,
    read_label_text,
    truth_boxes_3d,
)
from readers.truth.source import TruthSource

__all__ = ["CAR", "PredecessorTruth", "parse_odometry_rows"]

CAR = TruthVehicle("", "car", (0.33, 0.22, 0.21))
"""The model car: about 1 to 14."""

CAR_CENTER_Z_M = 0.112
"""Height of its centre where rows have none."""


class PredecessorTruth(TruthSource):
    """The rows of the odometry as a source of truth; see `TruthSource`.

    Args:
        path: The folder that has `odom`.
        rig: The rig of the result; the first vehicle of its truth is the car.
        config: Classes.

    Raises:
        RecordingError: there are no rows, or they cannot be read.
    """

    def __init__(self, path: Path, rig: Rig, config: Config) -> None:
        files = label_files(path / "odom", "txt")
        if not files:
            raise RecordingError(f"{path / 'odom'}: expected the car's odometry (30000.txt), found no .txt file")
        self._poses, self._sizes = parse_odometry_rows(read_label_text(files[-1]), files[-1])
        self._rig, self._car = rig, next(iter(rig.truth.values()), CAR)
        self._class_ids = class_ids_of_labels(config.classes)
        self.description = f"the car's odometry in {files[-1]}"

    @property
    def notes(self) -> tuple[str, ...]:
        """See `TruthSource`."""
        length, width, height = self._car.size_m
        box = (
            "with its box"
            if self._sizes is not None
            else f"a {self._car.label} of {length:g} x {width:g} x {height:g} m"
        )
        return (f"{self.description}: {len(self._poses)} rows, one for each frame, {box}; it has no stamps",)

    def at(self, stamp_ns: int, *, frame: int) -> TruthBoxes3D | None:
        """See `TruthSource`: the car in the site frame."""
        number = self._number(stamp_ns, frame)
        if number >= len(self._poses):
            return None
        pose = self._poses[number].copy()
        size_m = self._car.size_m
        if self._sizes is None:
            pose[:3, 3] += pose[:3, :3] @ np.array(self._car.offset_m)
        else:
            length, width, height = self._sizes[number].tolist()
            size_m = length, width, height
        car = Labelled(self._car.label, pose, size_m, track_id=0)
        return truth_boxes_3d(stamp_ns, self._rig.site_frame, [car], self._class_ids)

    def _number(self, stamp_ns: int, frame: int) -> int:
        """The number of a frame: by its stamp, where the folder itself was processed, else by its place."""
        number, rest_ns = divmod(stamp_ns - START_NS + STEP_NS // 2, STEP_NS)
        is_of_folder = 0 <= number < len(self._poses) and abs(rest_ns - STEP_NS // 2) <= 1
        return number if is_of_folder else frame


def parse_odometry_rows(text: str, path: Path) -> tuple[F64, F64 | None]:
    """The rows of an odometry file.

    Args:
        text: Its content.
        path: Named in errors.

    Returns:
        (N, 4, 4) poses of the car in the site frame, and (N, 3) length, width, height if the rows are boxes.

    Raises:
        RecordingError: the text is no table of numbers, or has another number of columns.
    """
    rows = _table(text, path)
    columns = rows.shape[1]
    poses = np.tile(np.eye(4), (len(rows), 1, 1))
    poses[:, :2, 3] = rows[:, :2]
    poses[:, 2, 3] = rows[:, 2] if columns > 3 else CAR_CENTER_Z_M
    sizes: F64 | None = None
    if columns in (7, 13) and _are_quaternions(rows[:, 3:7]):
        poses[:, :3, :3] = matrix_of_quaternion(rows[:, 3:7])
        return poses, None
    if columns == 13:
        raise RecordingError(f"{path}: expected a quaternion in columns 4 to 7 of 13, found other numbers")
    if columns == 7:
        sizes = rows[:, 3:6].copy()
        if not (sizes > 0).all():
            raise RecordingError(
                f"{path}: expected a quaternion, or a size and a yaw, in columns 4 to 7, found neither"
            )
    poses[:, :3, :3] = [matrix_of_rpy((0.0, 0.0, yaw)) for yaw in rows[:, -1]]
    return poses, sizes


def _table(text: str, path: Path) -> F64:
    lines = [line.replace(",", " ").split() for line in text.splitlines()]
    words = [line for line in lines if line and not line[0].startswith("#")]
    if not words:
        raise RecordingError(f"{path}: expected rows of numbers, found none")
    columns = len(words[0])
    if columns not in (3, 4, 7, 13) or any(len(line) != columns for line in words):
        other = next((len(line) for line in words if len(line) != columns), columns)
        raise RecordingError(
            f"{path}: expected rows of 3 (x y yaw), 4 (x y z yaw), 7 (position and quaternion, or a box) or 13 columns "
            f"(pose and velocities), found {other}"
        )
    try:
        rows = np.array(words, np.float64)
    except ValueError as err:
        raise RecordingError(f"{path}: expected rows of numbers: {err}") from err
    if not np.isfinite(rows).all():
        raise RecordingError(f"{path}: row {int(np.argmin(np.isfinite(rows).all(1)))}: expected finite numbers")
    return rows


def _are_quaternions(values: F64) -> bool:
    return bool((np.abs(np.linalg.norm(values, axis=1) - 1) <= MAX_OFF_UNIT).all())
