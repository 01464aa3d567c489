"""Autoware's sensors_calibration.yaml and sensor_kit_calibration.yaml.

Each maps a parent frame to child frames, and these to `x`, `y`, `z` (metres) and `roll`, `pitch`, `yaw` (radians): the
origin of a URDF joint, so the child's position in the parent, and roll about the parent's x, then pitch about its y,
then yaw about its z. Sources: https://autowarefoundation.github.io/autoware-documentation, "Creating a sensor model",
and http://wiki.ros.org/urdf/XML/joint (origin). The two files together lead from `base_link` to the sensors:
`--rig sensors_calibration.yaml --rig sensor_kit_calibration.yaml`.

Below the frames of the files, Autoware's URDF has one more: of `NAME_link` of a camera, `NAME_optical_link`, turned by
roll -90 and yaw -90 degrees (tier4/sensor_component_description, monocular_camera.xacro; REP 103), which is added here;
of `NAME_base_link` of a lidar, `NAME`, at a height that depends on the lidar's model, which is not.
"""

from collections.abc import Mapping
from math import degrees
from pathlib import Path
from typing import Any

from lidcam.readers.rig.importers.matrices import shaped
from lidcam.readers.rig.schema import RigFile, parse_rig

KEYS = ("x", "y", "z", "roll", "pitch", "yaw")
CAMERA_LINK, OPTICAL_LINK = "camera_link", "camera_optical_link"
OPTICAL_RPY_DEG = (-90.0, 0.0, -90.0)


def import_autoware(tree: Mapping[str, Any], path: Path) -> RigFile | None:
    """The transforms of a file, read from `path`; None if the content has another form.

    Raises:
        CalibrationError: a value is no number, or a frame has two parents.
    """
    rows = [row for row in tree.values() if isinstance(row, Mapping)]
    poses = [pose for row in rows for pose in row.values()]
    if not poses or len(rows) < len(tree) or not all(isinstance(p, Mapping) and set(p) == {*KEYS} for p in poses):
        return None
    transforms = {
        str(parent): {str(child): _pose(path, f"{parent}.{child}", pose) for child, pose in row.items()}
        for parent, row in tree.items()
    }
    links = [child for row in transforms.values() for child in row if child.endswith(CAMERA_LINK)]
    optical = {link: {link.removesuffix(CAMERA_LINK) + OPTICAL_LINK: {"rpy_deg": OPTICAL_RPY_DEG}} for link in links}
    return parse_rig({"transforms": transforms, "default_transforms": optical}, path)


def _pose(path: Path, name: str, pose: Mapping[str, Any]) -> dict[str, Any]:
    values = shaped(path, name, [pose[key] for key in KEYS], (1, 6))[0].tolist()
    return {"translation_m": values[:3], "rpy_deg": [*map(degrees, values[3:])]}
