"""KITTI's calibration files.

They have P0..P3 (3 x 4, rectified camera 0 to pixel), R0_rect and Tr_velo_to_cam (A. Geiger et al., "Vision meets
Robotics: The KITTI Dataset", IJRR 2013, equation 8: x = P_i R0_rect Tr_velo_to_cam X). They do not name topics: see
`assignment`.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.errors import CalibrationError
from lidcam.pipeline.core.settings.bounded_yaml import MAX_YAML_BYTES
from lidcam.pipeline.core.settings.model import MAX_NUMBER
from lidcam.pipeline.core.small_files import read_small_text
from lidcam.readers.rig.importers.matrices import camera_entry, flat, shaped
from lidcam.readers.rig.schema import LidarEntry, RigFile

KITTI_CAMERAS = (2, 3, 0, 1)
"""Colour cameras first: a recording with one camera has the left colour camera, `image_2`."""


_KITTI_LINE = re.compile(
    r"^(P\d|P_rect_\d\d|K_\d\d|Tr|Tr_velo_(to_)?cam|R0_rect|R_rect(_\d\d)?|calib_time):", re.MULTILINE
)


@dataclass(frozen=True, slots=True, eq=False)
class KittiCalibration:
    """The content of a calibration file of KITTI."""

    T_rect_velo: F64  # (4, 4) Velodyne to the rectified frame of camera 0, in which labels stand
    projections: Mapping[int, F64]  # (3, 4) rectified frame to pixels, by number of the camera
    sizes: Mapping[int, tuple[int, int]]  # Width and height in pixels, by number of the camera


def import_kitti(text: str, path: Path) -> RigFile | None:
    """The rectified cameras and the Velodyne, which is the site, of a KITTI file; None if the text has another form.

    Args:
        text: Content of `000008.txt` (object), `calib.txt` (odometry), `calib_cam_to_cam.txt` or
            `calib_velo_to_cam.txt` (raw).
        path: Its file; the other raw file must be beside it.

    Raises:
        CalibrationError: an entry is missing or has the wrong number of values.
    """
    calibration = kitti_calibration(text, path)
    if calibration is None:
        return None
    cameras = {}
    for number in KITTI_CAMERAS:
        if number not in calibration.projections:
            continue
        entry = camera_entry(calibration.T_rect_velo, calibration.projections[number])
        if size := calibration.sizes.get(number):
            entry = entry.model_copy(update={"width_px": size[0], "height_px": size[1]})
        cameras[f"cam{number}"] = entry
    if not cameras:
        raise CalibrationError(f"{path}: expected projections P0 to P3 or P_rect_00 to P_rect_03, found none")
    velodyne = LidarEntry(T_site_lidar=flat(np.eye(4)))
    return RigFile(site_frame="velodyne", lidars={"velodyne": velodyne}, cameras=cameras)


def kitti_calibration(text: str, path: Path) -> KittiCalibration | None:
    """The content of a KITTI file; None if the text has another form. Arguments and errors as of `import_kitti`."""
    if not _KITTI_LINE.search(text):
        return None
    values = _kitti_values(text, path)
    if "R" in values and "T" in values:
        values |= _kitti_file(path.with_name("calib_cam_to_cam.txt"))
    elif "P_rect_00" in values or "P_rect_02" in values:
        values |= _kitti_file(path.with_name("calib_velo_to_cam.txt"))
    if "R" in values:
        T_cam0_velo = np.eye(4)
        T_cam0_velo[:3, :3] = _kitti_matrix(path, values, ("R",), (3, 3))
        T_cam0_velo[:3, 3] = _kitti_matrix(path, values, ("T",), (3, 1))[:, 0]
    else:
        T_cam0_velo = np.vstack(
            [_kitti_matrix(path, values, ("Tr_velo_to_cam", "Tr_velo_cam", "Tr"), (3, 4)), [0, 0, 0, 1]]
        )
    T_rect_cam0 = np.eye(4)
    if "Tr" not in values or "R0_rect" in values:  # Tr of odometry leads to the rectified camera
        T_rect_cam0[:3, :3] = _kitti_matrix(path, values, ("R0_rect", "R_rect", "R_rect_00"), (3, 3))
    named = {number: (f"P{number}", f"P_rect_0{number}") for number in KITTI_CAMERAS}
    projections = {
        number: _kitti_matrix(path, values, names, (3, 4))
        for number, names in named.items()
        if any(name in values for name in names)
    }
    sizes = {number: values.get(f"S_rect_0{number}", []) for number in projections}
    return KittiCalibration(
        T_rect_cam0 @ T_cam0_velo,
        projections,
        {number: (int(size[0]), int(size[1])) for number, size in sizes.items() if len(size) == 2},
    )


def _kitti_file(path: Path) -> dict[str, list[float]]:
    return _kitti_values(read_small_text(path, MAX_YAML_BYTES, "KITTI calibration", CalibrationError), path)


def _kitti_values(text: str, path: Path) -> dict[str, list[float]]:
    """Numbers by name; lines of words (a date, a comment) are skipped.

    In files of the tracking benchmark, some names have no colon behind them.
    """
    values = {}
    for line in text.splitlines():
        name, separator, words = line.partition(":")
        if not separator:
            name, _, words = line.partition(" ")
        if not words or line.startswith("#"):
            continue
        try:
            values[name.strip()] = [float(word) for word in words.split()]
        except ValueError:
            continue
        if not all(abs(value) <= MAX_NUMBER for value in values[name.strip()]):
            raise CalibrationError(f"{path}: {name.strip()}: expected numbers of {MAX_NUMBER:g} or less in size")
    return values


def _kitti_matrix(path: Path, values: Mapping[str, list[float]], names: tuple[str, ...], shape: tuple[int, int]) -> F64:
    name = next((name for name in names if name in values), None)
    if name is None:
        raise CalibrationError(
            f"{path}: expected a line {' or '.join(names)}, found {', '.join(sorted(values)) or 'none'}"
        )
    return shaped(path, name, values[name], shape)
