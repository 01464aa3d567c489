"""A layout for Foxglove and Lichtblick in which all of a written MCAP is seen.

The form is that of an exported layout: `configById` has the settings of each panel, `layout` a tree of splits. Keys are
those of the panels of Lichtblick 1.28 (github.com/lichtblick-suite/lichtblick, packages/suite-base/src/panels), which
Foxglove shares.
"""

import json
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from pipeline.core.rig import CameraSensor, Rig
from writers.messages.edge_scenes import PLACED_SCENE, truth_scene_topic
from writers.outputs.marks import marked_json
from writers.panels import arrange
from writers.viewpoint import SceneSurvey, Viewpoint, cameras_in_order

__all__ = ["COMPARED", "foxglove_layout", "layout_path"]

COMPARED = "/compare/scene"
"""Topic of what differs between two results."""

FOV_Y_DEG = 45.0
"""Vertical field of view of the 3D panel."""

_EXTRA_SHARE = 0.27
"""Share of the scene's area for plots and diagnostics."""

_GROUND_COLOR, _FRUSTUM_COLOR, _TRANSFORM_LINE_COLOR = "#5a626eff", "#8d96a3ff", "#39414dff"
_OBJECTS_COLOR, _CONFIRMED_COLOR, _SKEW_COLOR = "#57b5fa", "#33f259", "#ffc21a"

_CLOUD = {"colorField": "z", "colorMode": "colormap", "colorMap": "turbo", "pointSize": 2}
_NO_OUTLINES = {"showOutlines": False}
_PRELOADED = {"scene": {"transforms": {"enablePreloading": True}}}

Config = dict[str, Any]
Split = str | dict[str, Any]


class _Panel(NamedTuple):
    id: str
    config: Config


def layout_path(path: Path) -> Path:
    """The path of the layout that belongs to an MCAP file: beside it."""
    return path.with_suffix(".foxglove.json")


def foxglove_layout(rig: Rig, survey: SceneSurvey, topics: Collection[str], names: Sequence[str] = ("",)) -> str:
    """The layout as JSON, marked so that an edited one is not replaced (viewers pass over the key `lidcam`).

    One view of the scene has all results of the file, with the clouds and the truth of the first that has them; each
    camera has the image of the first that has one, with what all have found in it. Plots are of a single result.

    Args:
        rig: The rig of the (first) result.
        survey: Content of the first frames, which places the eye.
        topics: Topics of the file that have messages; no other is named.
        names: Prefixes of the topics of each result of the file.
    """
    images = []
    for camera in cameras_in_order(rig):
        raw, compressed = (_existing(f"/{camera.name}/image{end}", topics, names) for end in ("", "/compressed"))
        images += [(camera, topic) for topic in (*raw, *compressed)][:1]
    panels = arrange([camera.model.width_px / camera.model.height_px for camera, _ in images])
    extra = [_plot("objects", _OBJECT_PATHS), _plot("skew", _SKEW_PATHS), _diagnostics()] if len(names) == 1 else []
    left, aspect = 1 - _EXTRA_SHARE, panels.scene_aspect
    if extra:
        aspect = aspect / left if panels.side == "right" else aspect * left
    viewpoint = survey.viewpoint(aspect=aspect, fov_y_deg=FOV_Y_DEG)
    scene = _Panel("3D!scene", _scene(rig, viewpoint, topics, names))
    cameras = [_image(camera, topic, topics, names) for camera, topic in images]
    layout: Split = scene.id
    if extra:
        ids = [panel.id for panel in extra]
        if panels.side == "right":
            layout = _split("column", layout, _row("row", ids), left)
        else:
            layout = _split("row", layout, _row("column", ids), left)
    if cameras:
        ids, columns = [panel.id for panel in cameras], panels.columns
        grid = _row("column", [_row("row", ids[first : first + columns]) for first in range(0, len(ids), columns)])
        if panels.side == "right":
            layout = _split("row", layout, grid, 1 - panels.image_share)
        else:
            layout = _split("column", grid, layout, panels.image_share)
    tree = {
        "configById": {panel.id: panel.config for panel in (scene, *cameras, *extra)},
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": layout,
    }
    return marked_json(json.dumps(tree, indent=2) + "\n")


def _existing(leaf: str, topics: Collection[str], names: Sequence[str]) -> list[str]:
    """The topics of this name that the results have."""
    return [topic for name in names if (topic := f"{name}{leaf}") in topics]


def _scene(rig: Rig, viewpoint: Viewpoint, topics: Collection[str], names: Sequence[str]) -> Config:
    size_m = viewpoint.size_m
    own = {topic.removeprefix(name) for topic in topics for name in names if topic.startswith(f"{name}/")}
    truth = sorted(leaf for leaf in own - {"/fused/scene", PLACED_SCENE} if leaf.endswith(truth_scene_topic("")))
    settings: Mapping[str, Config] = {
        "/point_cloud_combined": _CLOUD,
        "/ground_cloud": {"colorField": "z", "colorMode": "flat", "flatColor": _GROUND_COLOR, "pointSize": 1.5},
        "/fused/scene": _NO_OUTLINES,  # white ones; the objects bring their own
        **{
            f"/{camera.name}/camera_info": {"distance": _metres(size_m * 0.08), "color": _FRUSTUM_COLOR}
            for camera in rig.cameras
        },
        **dict.fromkeys(truth, _NO_OUTLINES),
    }
    shown: Config = {}
    for leaf, config in settings.items():
        found = _existing(leaf, topics, names)
        shown |= {one: {"visible": leaf == "/fused/scene" or one == found[0], **config} for one in found}
    if COMPARED in topics:
        shown[COMPARED] = {"visible": True, **_NO_OUTLINES}
    # The same objects once more, for RViz; and those that the cameras place, most of which are objects, too.
    shown |= {topic: {"visible": False} for topic in _existing("/fused/markers", topics, names)}
    shown |= {topic: {"visible": False, **_NO_OUTLINES} for topic in _existing(PLACED_SCENE, topics, names)}
    return {
        **_titled("Scene"),
        "followTf": rig.site_frame,
        "followMode": "follow-pose",
        "cameraState": _camera_state(viewpoint),
        "scene": {
            "backgroundColor": "#0d1017",
            "transforms": {
                "enablePreloading": True,  # else objects jump after a seek, says Lichtblick
                "axisScale": _metres(size_m * 0.03),
                "showLabel": False,
                "lineWidth": 1,
                "lineColor": _TRANSFORM_LINE_COLOR,
            },
        },
        "transforms": {},
        "topics": shown,
        "layers": {},
        "imageMode": {},
    }


def _camera_state(viewpoint: Viewpoint) -> Config:
    """The eye in the panel's angles: `phi` from straight above, `thetaOffset` 90 for an eye that looks along x."""
    away = viewpoint.eye - viewpoint.target
    distance_m = float(np.linalg.norm(away))
    return {
        "perspective": True,
        "distance": _metres(distance_m),
        "phi": round(float(np.degrees(np.arccos(away[2] / distance_m))), 2),
        "thetaOffset": round(float(-np.degrees(np.arctan2(away[0], -away[1]))), 2),
        "target": [0, 0, 0],
        "targetOffset": [_metres(value) for value in viewpoint.target.tolist()],
        "targetOrientation": [0, 0, 0, 1],
        "fovy": FOV_Y_DEG,
        "near": _metres(distance_m / 200),
        "far": _metres(distance_m * 200),
    }


def _image(camera: CameraSensor, topic: str, topics: Collection[str], names: Sequence[str]) -> _Panel:
    # Image and annotations have one log time. To synchronise them by stamps would hide an image without annotations.
    mode: Config = {"imageTopic": topic, "synchronize": False}
    if (calibration := f"{topic.removesuffix('/compressed').removesuffix('/image')}/camera_info") in topics:
        mode["calibrationTopic"] = calibration
    if annotations := _existing(f"/{camera.name}/annotations", topics, names):
        mode["annotations"] = {one: {"visible": True} for one in annotations}
    return _Panel(f"Image!{camera.name}", {**_titled(camera.name), "imageMode": mode, **_PRELOADED, "topics": {}})


def _of_diagnostics(key: str) -> str:
    return f'/diagnostics.status[:].values[:]{{key=="{key}"}}.value'


_OBJECT_PATHS = (
    ("fused", "objects", _OBJECTS_COLOR),
    ("confirmed by cameras", "confirmed by cameras", _CONFIRMED_COLOR),
)
_SKEW_PATHS = (("skew_ms", "sync skew (ms)", _SKEW_COLOR),)


def _plot(name: str, series: Sequence[tuple[str, str, str]]) -> _Panel:
    paths = [
        {"value": _of_diagnostics(key), "label": label, "color": color, "enabled": True}
        | {"timestampMethod": "receiveTime", "showLine": True}
        for key, label, color in series
    ]
    config = {
        **_titled(series[0][1]),
        "paths": paths,
        "minYValue": 0,
        "showLegend": True,
        "legendDisplay": "floating",
        "showPlotValuesInLegend": True,
        "showXAxisLabels": True,
        "showYAxisLabels": True,
        "isSynced": True,
        "xAxisVal": "timestamp",
        "sidebarDimension": 240,
    }
    return _Panel(f"Plot!{name}", config)


def _diagnostics() -> _Panel:
    config = {"minLevel": 0, "pinnedIds": [], "hardwareIdFilter": "", "topicToRender": "/diagnostics"}
    return _Panel("DiagnosticSummary!lidcam", {**_titled("Diagnostics"), **config, "sortByLevel": True})


def _titled(title: str) -> Config:
    return {"foxglovePanelTitle": title, "lichtblickPanelTitle": title}


def _row(direction: Literal["row", "column"], parts: Sequence[Split]) -> Split:
    """Parts of equal size side by side, or one below the other."""
    if len(parts) == 1:
        return parts[0]
    return _split(direction, parts[0], _row(direction, parts[1:]), 1 / len(parts))


def _split(direction: Literal["row", "column"], first: Split, second: Split, share: float) -> Split:
    return {"first": first, "second": second, "direction": direction, "splitPercentage": round(100 * share, 1)}


def _metres(value: float) -> float:
    return round(float(value), 3)
