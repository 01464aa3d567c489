"""Truth from the evaluation folder of the predecessor system: the odometry of its one car.

`odom/*.txt` has a row for each frame, the N-th for `pcd/N.txt` and `img/N/`; of several files the one with the largest
number holds all (`30000.txt`). How the system read a row was never published, so the number of columns says what it is:
3 are x, y, yaw; 4 are x, y, z, yaw; 7 are position and quaternion (x, y, z, w), or, where the last four are no
quaternion, a whole box (x, y, z, length, width, height, yaw); 13 are a pose with its velocities. Metres and radians in
the site frame. The box of the car is that of the rig's section `truth`, else that of the system's model car.
"""

import warnings
from io import BytesIO, TextIOWrapper
from pathlib import Path

import numpy as np

from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.errors import RecordingError
from lidcam.pipeline.core.geometry.rotations import matrix_of_quaternion, matrix_of_rpy
from lidcam.pipeline.core.rig import Rig, TruthVehicle
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.core.small_files import read_small_text
from lidcam.pipeline.evaluation.evaluation_frame import TruthBoxes3D
from lidcam.readers.files.evaluation_folder import START_NS, STEP_NS
from lidcam.readers.truth.boxes import MAX_OFF_UNIT, Labelled, label_files, truth_boxes_3d
from lidcam.readers.truth.source import TruthSource

MAX_ODOMETRY_BYTES = 256 << 20
"""More than an hour at 400 Hz."""

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
        self._rows = _read_rows(files[-1])
        self._is_box = self._rows.shape[1] == 7 and not _are_quaternions(self._rows)
        self._rig, self._car = rig, next(iter(rig.truth.values()), CAR)
        self._class_ids = config.class_id_of_label
        self.description = f"the car's odometry in {files[-1]}"

    @property
    def notes(self) -> tuple[str, ...]:
        """See `TruthSource`."""
        length, width, height = self._car.size_m
        box = "with its box" if self._is_box else f"a {self._car.label} of {length:g} x {width:g} x {height:g} m"
        return (f"{self.description}: {len(self._rows)} rows, one for each frame, {box}; it has no stamps",)

    def at(self, stamp_ns: int, *, frame: int) -> TruthBoxes3D | None:
        """See `TruthSource`: the car in the site frame."""
        number = self._number(stamp_ns, frame)
        if number >= len(self._rows):
            return None
        row = self._rows[number]
        pose = np.eye(4)
        pose[:2, 3] = row[:2]
        pose[2, 3] = row[2] if len(row) > 3 else CAR_CENTER_Z_M
        has_yaw = self._is_box or len(row) < 7
        pose[:3, :3] = matrix_of_rpy((0.0, 0.0, row[-1])) if has_yaw else matrix_of_quaternion(row[3:7])
        size_m = self._car.size_m
        if self._is_box:
            length, width, height = row[3:6].tolist()
            size_m = length, width, height
        else:
            pose[:3, 3] += pose[:3, :3] @ np.array(self._car.offset_m)
        car = Labelled(self._car.label, pose, size_m, track_id=0)
        return truth_boxes_3d(stamp_ns, self._rig.site_frame, [car], self._class_ids)

    def _number(self, stamp_ns: int, frame: int) -> int:
        """The number of a frame: by its stamp, where the folder itself was processed, else by its place."""
        number, rest_ns = divmod(stamp_ns - START_NS + STEP_NS // 2, STEP_NS)
        is_of_folder = 0 <= number < len(self._rows) and abs(rest_ns - STEP_NS // 2) <= 1
        return number if is_of_folder else frame


def _read_rows(path: Path) -> F64:
    """(N, 3, 4, 7 or 13) the rows of an odometry file."""
    data = read_small_text(path, MAX_ODOMETRY_BYTES, "the car's odometry", RecordingError).encode()
    lines = (line.replace(",", " ") for line in TextIOWrapper(BytesIO(data), "utf-8"))
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of a file without rows
            rows = np.loadtxt(lines, np.float64, ndmin=2)
    except ValueError as err:
        raise RecordingError(f"{path}: expected rows of numbers, the same in all: {err}") from err
    count, columns = rows.shape
    if not count:
        raise RecordingError(f"{path}: expected rows of numbers, found none")
    if columns not in (3, 4, 7, 13):
        raise RecordingError(
            f"{path}: expected rows of 3 (x y yaw), 4 (x y z yaw), 7 (position and quaternion, or a box) or 13 columns "
            f"(pose and velocities), found {columns}"
        )
    if not np.isfinite(rows).all():
        raise RecordingError(f"{path}: row {int(np.argmin(np.isfinite(rows).all(1)))}: expected finite numbers")
    if columns == 13 and not _are_quaternions(rows):
        raise RecordingError(f"{path}: expected a quaternion in columns 4 to 7 of 13, found other numbers")
    if columns == 7 and not _are_quaternions(rows) and not (rows[:, 3:6] > 0).all():
        raise RecordingError(f"{path}: expected a quaternion, or a size and a yaw, in columns 4 to 7, found neither")
    return rows


def _are_quaternions(rows: F64) -> bool:
    return bool((np.abs(np.linalg.norm(rows[:, 3:7], axis=1) - 1) <= MAX_OFF_UNIT).all())
