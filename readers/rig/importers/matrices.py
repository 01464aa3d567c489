"""Matrices of calibration files as entries of a rig file."""

from pathlib import Path
from typing import Any

import numpy as np

from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.errors import CalibrationError
from lidcam.readers.rig.extrinsics import decompose_projection
from lidcam.readers.rig.schema import CameraEntry


def camera_entry(T_camera_site: F64, projection: F64) -> CameraEntry:
    """A camera from its pose (4, 4) and the projection (3, 4) of its frame, which need not be an optical one.

    Matrices that are not valid are kept, and become a fault of the rig, which says why.
    """
    try:
        K, T_optical_camera = decompose_projection("projection", projection)
    except CalibrationError:
        return CameraEntry(P=flat(projection @ T_camera_site))
    return CameraEntry(K=flat(K), T_camera_site=flat(T_optical_camera @ T_camera_site))


def shaped(path: Path, name: str, value: Any, shape: tuple[int, int]) -> F64:
    """Numbers of a file as an array of `shape`.

    Raises:
        CalibrationError: there are more or fewer of them, or other things.
    """
    try:
        matrix = np.array(value, np.float64)
    except (TypeError, ValueError):
        matrix = np.zeros(0)
    if matrix.size != shape[0] * shape[1]:
        raise CalibrationError(f"{path}: {name}: expected {shape[0]} x {shape[1]} numbers, found {matrix.size}")
    return matrix.reshape(shape)


def flat(matrix: F64) -> tuple[float, ...]:
    """Numbers of a matrix, row by row."""
    return tuple(matrix.reshape(-1).tolist())
