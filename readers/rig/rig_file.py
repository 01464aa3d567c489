"""Rig files: read in every form that lidcam knows, and their text."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml

from pipeline.core.arrays import F64
from pipeline.core.errors import CalibrationError
from pipeline.core.geometry.transform import Transform
from pipeline.core.rig import Rig, TruthVehicle, Zone
from pipeline.core.settings.bounded_yaml import read_yaml
from readers.rig.schema import TODO, RigFile, parse_rig

if TYPE_CHECKING:  # for `inspect` alone
    from readers.rig.draft import DraftCamera, RigDraft

__all__ = ["draft_yaml", "load_rig", "rig_yaml"]


def load_rig(path: str | Path) -> RigFile:
    """A rig file of lidcam, or a calibration file of another system; the content says which.

    Known are the predecessor system's geometry.yaml (`w2c`, `c2p`) and calib.txt, the files of KITTI, Kalibr's camchain
    and Autoware's sensors_calibration and sensor_kit_calibration.

    Raises:
        CalibrationError: the file cannot be read, or its content does not fit; names the file and the key.
        ConfigError: the file is not a YAML mapping.
    """
    # Most runs have no rig file.
    from readers.rig.importers.autoware import import_autoware
    from readers.rig.importers.kalibr import import_kalibr
    from readers.rig.importers.kitti import import_kitti
    from readers.rig.importers.predecessor import import_calib_txt, import_geometry

    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError as err:
        raise CalibrationError(f"{path}: expected a rig file, found no such file") from err
    except (OSError, UnicodeDecodeError) as err:
        raise CalibrationError(f"{path}: cannot be read as a rig file: {err}") from err
    for import_text in (import_calib_txt, import_kitti):
        if rig := import_text(text, path):
            return rig
    tree = read_yaml(path)
    for import_tree in (import_geometry, import_kalibr, import_autoware):
        if rig := import_tree(tree, path):
            return rig
    return parse_rig(tree, path)


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
    tree["zones"] = {zone.name: _zone(zone) for zone in rig.zones}
    if rig.truth:
        tree["truth"] = _truth(rig.truth)
    return _HEADER + yaml.dump(tree, Dumper=_Dumper, sort_keys=False, width=120, allow_unicode=True)


def draft_yaml(draft: "RigDraft") -> str:
    """The text of a rig file with every sensor that was found; what is not known is `TODO`, with the reason."""
    lines = [_HEADER.rstrip(), *_key("site_frame", draft.site_frame, draft.site_source)]
    if draft.ground_height_m is not None:
        lines += _key("ground_height_m", draft.ground_height_m)
    lines += ["lidars:" if draft.lidars else "lidars: {}"]
    for lidar in draft.lidars:
        values = _key("topic", lidar.topic, f"{lidar.msgtype}, {lidar.size}")
        values += _key("frame_id", lidar.frame_id)
        values += _pose("T_site_lidar", lidar.T_site_lidar, lidar.problem)
        values += _offset_lines(lidar.time_offset_ns)
        lines += [f"  {lidar.name}:", *(f"    {line}" for line in values)]
    lines += ["cameras:" if draft.cameras else "cameras: {}"]
    for camera in draft.cameras:
        lines += [f"  {camera.name}:", *(f"    {line}" for line in _camera_lines(camera))]
    lines += ["zones:" if draft.zones else "zones: {}"]
    for zone in draft.zones:
        lines += [f"  {line}" for line in _key(zone.name, _zone(zone))]
    if draft.truth:
        lines += yaml.dump({"truth": _truth(draft.truth)}, Dumper=_Dumper, sort_keys=False, width=120).splitlines()
    for key, edges in draft.transforms.items():
        lines += yaml.safe_dump({key: edges}, sort_keys=False).splitlines() if edges else []
    return "".join(f"{line}\n" for line in lines)


def _camera_lines(camera: "DraftCamera") -> list[str]:
    lines = _key("topic", camera.topic, camera.msgtype) if camera.topic else []
    if camera.boxes_topic:
        lines += _key("boxes_topic", camera.boxes_topic, "" if camera.topic else camera.msgtype)
    if camera.frame_id:
        lines += _key("frame_id", camera.frame_id)
    width, height = camera.size_px or (TODO, TODO)
    lines += [*_key("width_px", width), *_key("height_px", height)]
    if camera.model is None:
        why = f"TODO 3 x 3, pixels; then distortion_model and distortion ({camera.model_problem})"
        lines += _key("K", TODO, why)
    else:
        lines += _key("K", _rows(camera.model.K))
        lines += _key("distortion_model", camera.model.model)
        lines += _key("distortion", _Row(camera.model.distortion.tolist()))
    lines += _pose("T_camera_site", camera.T_camera_site, camera.pose_problem)
    return lines + _offset_lines(camera.time_offset_ns)


def _offset_lines(offset_ns: int) -> list[str]:
    return [line for key, value in _time_offset(offset_ns).items() for line in _key(key, value)]


def _pose(key: str, pose: Transform | None, problem: str) -> list[str]:
    if pose is not None:
        return _key(key, _rows(pose.matrix))
    return _key(key, TODO, f"TODO 4 x 4, metres; or translation_m and rpy_deg in its place ({problem})")


def _key(key: str, value: Any, comment: str = "") -> list[str]:
    """Lines of one key, with a comment behind the first."""
    text = yaml.dump({key: value}, Dumper=_Dumper, sort_keys=False, width=1000, allow_unicode=True)
    first, *more = text.splitlines()
    comment = "".join(letter if letter.isprintable() else " " for letter in comment)
    return [f"{first} # {comment}" if comment else first, *more]


def _zone(zone: Zone) -> list[_Row] | dict[str, Any]:
    corners = _rows(zone.polygon_site)
    return corners if zone.use == "count" else {"corners": corners, "use": zone.use}


def _truth(vehicles: Mapping[str, TruthVehicle]) -> dict[str, Any]:
    return {
        name: {
            "topic": vehicle.topic,
            "size_m": _Row(vehicle.size_m),
            "offset_m": _Row(vehicle.offset_m),
            "class": vehicle.label,
        }
        for name, vehicle in vehicles.items()
    }


def _time_offset(offset_ns: int) -> dict[str, float]:
    """The key of a sensor whose stamps are corrected."""
    return {"time_offset_ms": offset_ns / 1e6} if offset_ns else {}


def _rows(matrix: F64) -> list[_Row]:
    return [_Row(row) for row in matrix.tolist()]
