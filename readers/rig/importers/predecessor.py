"""Calibration files of the predecessor system.

`geometry.yaml` has, by camera, `width` and `height`, `w2c` (4 x 4, world to the camera's optical frame) and `c2p`
(3 x 4, camera to pixel). `calib.txt` is written by numpy.savetxt with a row of 29 numbers for each camera: its number,
sixteen of the matrix from the world to the camera's body frame (x forward, y left, z up, as in Gazebo), and twelve of
`c2p`. Its reader, `world2pixel`, takes c2p (y, z, -x, -x) / (-x) of a point x, y, z in the body frame. Both give
positions in metres, in one world frame that they do not name, and neither knows the lidars' poses in it.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from lidcam.pipeline.core.errors import CalibrationError
from lidcam.readers.rig.importers.matrices import camera_entry, shaped
from lidcam.readers.rig.schema import RigFile, parse_rig

COLUMNS = 1 + 16 + 12

# (x, y, z, 1) in the body frame to (-y, -z, x, x), to which `c2p` is applied: its last column adds to u and v.
_OPTICAL_BODY = np.array([[0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [1, 0, 0, 0]], np.float64)


def import_geometry(tree: Mapping[str, Any], path: Path) -> RigFile | None:
    """The cameras of a geometry.yaml, read from `path`; None if the content has another form.

    A camera named by a number, 11, is called cam11.

    Raises:
        CalibrationError: a matrix is missing or has the wrong number of values, or a name is not an identifier.
    """
    entries = {}
    cameras = tree.get("cameras", tree)
    for key, camera in cameras.items() if isinstance(cameras, Mapping) else ():
        if isinstance(camera, Mapping) and {"w2c", "c2p"} & set(camera):
            name = str(key)
            w2c = shaped(path, f"{name}.w2c", camera.get("w2c"), (4, 4))
            c2p = shaped(path, f"{name}.c2p", camera.get("c2p"), (3, 4))
            size = {"width_px": camera.get("width"), "height_px": camera.get("height")}
            entry = camera_entry(w2c, c2p).model_dump(exclude_defaults=True)
            entries[f"cam{name}" if name.isdecimal() else name] = entry | size
    return parse_rig({"cameras": entries}, path) if entries else None


def import_calib_txt(text: str, path: Path) -> RigFile | None:
    """The cameras of a calib.txt, read from `path`, called by their numbers: cam11; None if it has another form.

    Raises:
        CalibrationError: a camera is there twice, or has no whole number.
    """
    lines = [line.split() for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")]
    if not lines or {len(line) for line in lines} != {COLUMNS}:
        return None
    try:
        rows = np.array(lines, np.float64)
    except ValueError:
        return None
    numbers = rows[:, 0]
    if not (np.isfinite(numbers).all() and (numbers == np.rint(numbers)).all() and (numbers >= 0).all()):
        raise CalibrationError(f"{path}: expected the number of a camera first in each row, found {numbers.tolist()}")
    names = [f"cam{int(number)}" for number in numbers]
    if len({*names}) < len(names):
        raise CalibrationError(f"{path}: expected each camera once, found {', '.join(names)}")
    entries = {
        name: camera_entry(row[1:17].reshape(4, 4), row[17:].reshape(3, 4) @ _OPTICAL_BODY)
        for name, row in zip(names, rows, strict=True)
    }
    return RigFile(cameras=entries)
