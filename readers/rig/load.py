"""Rig files in every form that lidcam reads, told apart by content."""

import re
from pathlib import Path

from pipeline.core.errors import CalibrationError
from pipeline.core.settings.bounded_yaml import read_yaml
from readers.rig.importers import import_geometry_yaml, import_kitti_calib, is_geometry_tree
from readers.rig.rig_file import RigFile, parse_rig

__all__ = ["load_rig"]

_KITTI_LINE = re.compile(
    r"^(P\d|P_rect_\d\d|K_\d\d|Tr|Tr_velo_(to_)?cam|R0_rect|R_rect(_\d\d)?|calib_time):", re.MULTILINE
)


def load_rig(path: Path) -> RigFile:
    """A rig file of lidcam, a geometry.yaml of the original (`w2c`, `c2p`), or a calibration file of KITTI.

    Raises:
        CalibrationError: the file cannot be read, or its content does not fit; names the file and the key.
        ConfigError: the file is no YAML mapping.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as err:
        raise CalibrationError(f"{path}: cannot be read as a rig file: {err}") from err
    if _KITTI_LINE.search(text):
        return import_kitti_calib(path)
    tree = read_yaml(path)
    return import_geometry_yaml(path) if is_geometry_tree(tree) else parse_rig(tree, path)
