"""A scenario that is simulated in moments: one lidar, one camera, the two cars of the sandbox."""

from copy import deepcopy
from pathlib import Path
from typing import Any

import yaml

SMALL: dict[str, Any] = yaml.safe_load("""
world: sandbox
routes: {along: {points_m: [[-1.6, 1.85], [1.6, 1.85]]}}
vehicles:
  car1: {shape: model_car, start: [-1.5, 1.35, 0], odometry: true, commands: true}
  car2: {shape: model_car, route: along, speed_m_s: 0.5, start: [-1.5, 1.85, 0], odometry: true, commands: true}
lidars:
  top: {topic: /points, packets_topic: /packets, frame_id: top, position_m: [0.0, 0.3, 0.4], firing_stride: 4,
    max_range_m: 50.0}
cameras:
  front: {topic: /image, info_topic: /info, frame_id: front, position_m: [-1.9, 0.6, 0.5], rpy_deg: [0, 15, 30],
    width_px: 160, height_px: 120, focal_px: [120, 120], phase_ms: 10, detector: {topic: /boxes}}
""")


def small_scenario(**changes: Any) -> dict[str, Any]:
    """The scenario as a tree; changes go in as `lidars__top__rate_hz=20`."""
    tree = deepcopy(SMALL)
    for key, value in changes.items():
        *parents, leaf = key.split("__")
        branch = tree
        for parent in parents:
            branch = branch.setdefault(parent, {})
        branch[leaf] = value
    return tree


def write_small_scenario(path: Path, **changes: Any) -> Path:
    """The same as a file."""
    path.write_text(yaml.safe_dump(small_scenario(**changes)), encoding="utf-8")
    return path
