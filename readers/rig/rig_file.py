"""Rig files: read in every form that lidcam knows, and their text."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.errors import CalibrationError
from lidcam.pipeline.core.rig import Rig, TruthVehicle, Zone
from lidcam.pipeline.core.settings.bounded_yaml import MAX_YAML_BYTES, yaml_mapping
from lidcam.pipeline.core.small_files import read_small_text
from lidcam.readers.rig.schema import RigFile, parse_rig


def load_rig(path: str | Path) -> RigFile:
    """A rig file of lidcam, or a calibration file of another system; the content says which.

    Known are the files of KITTI, Kalibr's camchain and Autoware's sensors_calibration and sensor_kit_calibration.

    Raises:
        CalibrationError: the file cannot be read, or its content does not fit; names the file and the key.
        ConfigError: the file is not a YAML mapping.
    """
    # Most runs have no rig file.
    from lidcam.readers.rig.importers import import_autoware, import_kalibr, import_kitti

    path = Path(path)
    text = read_small_text(path, MAX_YAML_BYTES, "a rig file", CalibrationError)
    if rig := import_kitti(text, path):
        return rig
    tree = yaml_mapping(text, path)
    for import_tree in (import_kalibr, import_autoware):
        if rig := import_tree(tree, path):
            return rig
    return parse_rig(tree, path)


class Row(list[float]):
    """Numbers that are written on one line."""


class _Dumper(yaml.SafeDumper):
    pass


_Dumper.add_representer(
    Row, lambda dumper, row: dumper.represent_sequence("tag:yaml.org,2002:seq", row, flow_style=True)
)

RIG_HEADER = """\
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
            "T_site_lidar": matrix_rows(lidar.T_site_lidar.matrix),
            **time_offset(lidar.time_offset_ns),
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
            "K": matrix_rows(camera.model.K),
            "distortion_model": camera.model.model,
            "distortion": Row(camera.model.distortion.tolist()),
            "T_camera_site": matrix_rows(camera.T_camera_site.matrix),
            **time_offset(camera.time_offset_ns),
        }
        for camera in rig.cameras
    }
    tree["zones"] = {zone.name: zone_tree(zone) for zone in rig.zones}
    if rig.truth:
        tree["truth"] = truth_tree(rig.truth)
    return RIG_HEADER + dumped(tree)


def dumped(tree: Mapping[str, Any], width: int = 120) -> str:
    """A part of a rig file as YAML, in its order; a `Row` stands on one line, of at most `width` characters."""
    return yaml.dump(tree, Dumper=_Dumper, sort_keys=False, width=width, allow_unicode=True)


def zone_tree(zone: Zone) -> list[Row] | dict[str, Any]:
    """The value of a zone."""
    corners = matrix_rows(zone.polygon_site)
    return corners if zone.use == "count" else {"corners": corners, "use": zone.use}


def truth_tree(vehicles: Mapping[str, TruthVehicle]) -> dict[str, Any]:
    """The section `truth`."""
    return {
        name: {
            "topic": vehicle.topic,
            "size_m": Row(vehicle.size_m),
            "offset_m": Row(vehicle.offset_m),
            "class": vehicle.label,
        }
        for name, vehicle in vehicles.items()
    }


def time_offset(offset_ns: int) -> dict[str, float]:
    """The key of a sensor whose stamps are corrected."""
    return {"time_offset_ms": offset_ns / 1e6} if offset_ns else {}


def matrix_rows(matrix: F64) -> list[Row]:
    """A matrix, or corners (N, 2), one row a line."""
    return [Row(row) for row in matrix.tolist()]
