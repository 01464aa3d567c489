"""Rig files: read in every form that lidcam knows, and written."""

from pathlib import Path
from typing import Any

import yaml

from pipeline.core.arrays import F64
from pipeline.core.errors import CalibrationError, OutputError
from pipeline.core.rig import Rig
from pipeline.core.settings.bounded_yaml import read_yaml
from readers.rig.importers import import_geometry, import_kitti
from readers.rig.schema import RigFile, parse_rig

__all__ = ["load_rig", "rig_yaml", "write_rig"]


def load_rig(path: str | Path) -> RigFile:
    """A rig file of lidcam, a geometry.yaml (`w2c`, `c2p`) or a calibration file of KITTI; the content says which.

    Raises:
        CalibrationError: the file cannot be read, or its content does not fit; names the file and the key.
        ConfigError: the file is not a YAML mapping.
    """
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as err:
        raise CalibrationError(f"{path}: cannot be read as a rig file: {err}") from err
    if rig := import_kitti(text, path):
        return rig
    tree = read_yaml(path)
    return import_geometry(tree, path) or parse_rig(tree, path)


class _Row(list[float]):
    """Numbers that are written on one line."""


class _Dumper(yaml.SafeDumper):
    pass


_Dumper.add_representer(
    _Row, lambda dumper, row: dumper.represent_sequence("tag:yaml.org,2002:seq", row, flow_style=True)
)

_HEADER = """\
# Sensors, calibration and zones for lidcam (--rig). Metres, degrees, pixels; x forward, y left, z up (REP 103).
# T_site_lidar maps points of the lidar's frame to the site frame, T_camera_site those of the site frame to the camera's
# optical frame (z forward, x right, y down). What is left out is taken from the recording.
"""


def rig_yaml(rig: Rig) -> str:
    """The text of a rig file, which reads back to the same numbers."""
    tree: dict[str, Any] = {"site_frame": rig.site_frame}
    if rig.ground_height_m is not None:
        tree["ground_height_m"] = rig.ground_height_m
    tree["lidars"] = {
        lidar.name: {
            "topic": lidar.topic,
            "frame_id": lidar.T_site_lidar.src,
            "T_site_lidar": _rows(lidar.T_site_lidar.matrix),
            **_time_offset(lidar.time_offset_ns),
        }
        for lidar in rig.lidars
    }
    tree["cameras"] = {
        camera.name: {
            **({"topic": camera.topic} if camera.topic else {}),
            **({"boxes_topic": camera.boxes_topic} if camera.boxes_topic else {}),
            "frame_id": camera.T_camera_site.dst,
            "width_px": camera.model.width_px,
            "height_px": camera.model.height_px,
            "K": _rows(camera.model.K),
            "distortion_model": camera.model.model,
            "distortion": _Row(camera.model.distortion.tolist()),
            "T_camera_site": _rows(camera.T_camera_site.matrix),
            **_time_offset(camera.time_offset_ns),
        }
        for camera in rig.cameras
    }
    tree["zones"] = {zone.name: _rows(zone.polygon_site) for zone in rig.zones}
    return _HEADER + yaml.dump(tree, Dumper=_Dumper, sort_keys=False, width=120, allow_unicode=True)


def write_rig(rig: Rig, path: Path) -> None:
    """Write `rig_yaml`; the file appears whole or not at all.

    Raises:
        OutputError: the file cannot be written.
    """
    part = path.with_name(f"{path.name}.part")
    try:
        part.write_text(rig_yaml(rig), encoding="utf-8")
        part.replace(path)
    except OSError as err:
        part.unlink(missing_ok=True)
        raise OutputError(f"{path}: cannot be written: {err}") from err


def _time_offset(offset_ns: int) -> dict[str, float]:
    """The key of a sensor whose stamps are corrected."""
    return {"time_offset_ms": offset_ns / 1e6} if offset_ns else {}


def _rows(matrix: F64) -> list[_Row]:
    return [_Row(row) for row in matrix.tolist()]
