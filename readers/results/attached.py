"""The settings, the rig and the summary of a result, from the texts that are attached to it.

A text of another kind raises a `RecordingError`, a rig that does not fit a `CalibrationError`.
"""

import json
from itertools import takewhile
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from pydantic import ValidationError

from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.camera import CameraModel
from lidcam.pipeline.core.errors import CalibrationError, RecordingError
from lidcam.pipeline.core.geometry.transform import Transform
from lidcam.pipeline.core.rig import CameraSensor, LidarSensor, Rig
from lidcam.pipeline.core.settings.bounded_yaml import parse_yaml
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.core.settings.validation import path_in
from lidcam.readers.results.attached_records import CONFIG, RIG, SUMMARY
from lidcam.readers.rig.schema import CameraEntry, LidarEntry, parse_rig
from lidcam.readers.rig.search import zones_of

MAX_ROUNDS = 20
"""Largest number of times that settings are judged anew, without those that do not fit."""


def attached_config(text: str, path: Path, version: str) -> tuple[Config, tuple[str, ...]]:
    """The settings of a result, and what the user should know of them.

    Other versions of lidcam have other settings: a key that is missing gets its default, one that is unknown, or has a
    value that does not fit any more, is left out.
    """
    tree = _tree(text, path, CONFIG)
    left_out: list[str] = []
    for _ in range(MAX_ROUNDS):
        try:
            config = Config.model_validate(tree)
        except ValidationError as err:
            paths = dict.fromkeys(path_in(tree, fault["loc"]) for fault in err.errors(include_url=False))
            left_out += [key for path in paths if (key := _without(tree, path))]
        else:
            note = f"{path.name} is of lidcam {version}, whose settings differ: not used: {', '.join(left_out)}"
            return config, (note,) if left_out else ()
    raise RecordingError(
        f"{path}: expected settings of lidcam in the attached {CONFIG}, found others (written by version {version})"
    )


def attached_summary(text: str, path: Path) -> dict[str, Any]:
    """The summary of the run that made a result; raises RecordingError if the text is not a JSON object."""
    try:
        tree = json.loads(text)
    except ValueError as err:
        raise RecordingError(f"{path}: the attached {SUMMARY} is not JSON: {err}") from err
    if not isinstance(tree, dict):
        raise RecordingError(f"{path}: expected an object in the attached {SUMMARY}, found {type(tree).__name__}")
    return tree


def attached_rig(text: str, path: Path, config: Config) -> Rig:
    """The rig of a result."""
    rig_file = parse_rig(_tree(text, path, RIG), path)
    site = rig_file.site_frame
    lidars = [_lidar(name, entry, site, path) for name, entry in (rig_file.lidars or {}).items()]
    cameras = [_camera(name, entry, site, path) for name, entry in (rig_file.cameras or {}).items()]
    zones, ground_height_m = zones_of(rig_file, config), rig_file.ground_height_m
    return Rig(site, tuple(lidars), tuple(cameras), zones, ground_height_m, rig_file.vehicles)


def _tree(text: str, path: Path, name: str) -> dict[str, Any]:
    try:
        tree = parse_yaml(text)
    except yaml.YAMLError as err:
        raise RecordingError(f"{path}: the attached {name} is not YAML: {' '.join(str(err).split())}") from err
    if not isinstance(tree, dict):
        raise RecordingError(f"{path}: expected a mapping in the attached {name}, found {type(tree).__name__}")
    return tree


def _without(tree: dict[str, Any], path: tuple[int | str, ...]) -> str:
    """Take a setting, or the whole list that it is in, out of a tree: its dotted key; empty if it is gone already."""
    keys = [str(key) for key in takewhile(lambda key: isinstance(key, str), path)]
    holder = tree
    for key in keys[:-1]:
        holder = holder.get(key, {})
    if not keys or keys[-1] not in holder:
        return ""
    del holder[keys[-1]]
    return ".".join(keys)


def _lidar(name: str, entry: LidarEntry, site: str, path: Path) -> LidarSensor:
    if entry.T_site_lidar is None:
        raise CalibrationError(f"{path}: expected T_site_lidar of {name} in the attached {RIG}, found none")
    pose = Transform(site, entry.frame_id or name, _matrix(entry.T_site_lidar))
    return LidarSensor(name, entry.topic, pose, entry.time_offset_ns)


def _camera(name: str, entry: CameraEntry, site: str, path: Path) -> CameraSensor:
    if entry.T_camera_site is None or entry.K is None or entry.width_px is None or entry.height_px is None:
        raise CalibrationError(
            f"{path}: expected T_camera_site, K, width_px and height_px of {name} in the attached {RIG}, found "
            f"{', '.join(sorted(entry.model_fields_set))}"
        )
    frame_id = entry.frame_id or name
    model = CameraModel(
        frame_id,
        entry.width_px,
        entry.height_px,
        np.array(entry.K, np.float64).reshape(3, 3),
        entry.distortion_model,  # type: ignore[arg-type]  # the model checks it
        np.array(entry.distortion, np.float64),
    )
    pose = Transform(frame_id, site, _matrix(entry.T_camera_site))
    return CameraSensor(name, entry.topic, entry.boxes_topic, model, pose, entry.time_offset_ns)


def _matrix(numbers: tuple[float, ...]) -> F64:
    return np.array(numbers, np.float64).reshape(4, 4)
