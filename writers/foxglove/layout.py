"""A layout for Foxglove and Lichtblick in which all of a written MCAP is seen.

The form is that of an exported layout: `configById` has the settings of each panel, `layout` a tree of splits. Keys are
those of the panels of Lichtblick 1.28 (github.com/lichtblick-suite/lichtblick, packages/suite-base/src/panels), which
Foxglove shares.
"""

import json
from collections.abc import Collection, Mapping, Sequence
from typing import Any, Literal, NamedTuple

import numpy as np

from pipeline.core.rig import CameraSensor, Rig
from writers.messages.placed_scene import PLACED_SCENE
from writers.messages.truth_scene import truth_scene_topic
from writers.outputs.marked_text import marked_json
from writers.panels import arrange
from writers.viewpoint import SceneSurvey, Viewpoint, cameras_in_order

__all__ = ["COMPARED", "foxglove_layout", "merged_layout"]

COMPARED = "/compare/scene"
"""Topic of what differs between two results."""

FOV_Y_DEG = 45.0
"""Of the 3D panel's eye."""

_EXTRA_SHARE = 0.27
"""Of the scene, for plots and diagnostics."""

_GROUND_COLOR, _FRUSTUM_COLOR, _TRANSFORM_LINE_COLOR = "#5a626eff", "#8d96a3ff", "#39414dff"
_OBJECTS_COLOR, _CONFIRMED_COLOR, _SKEW_COLOR = "#57b5fa", "#33f259", "#ffc21a"

_CLOUD = {"colorField": "z", "colorMode": "colormap", "colorMap": "turbo", "pointSize": 2}
_PRELOADED = {"scene": {"transforms": {"enablePreloading": True}}}

Config = dict[str, Any]
Split = str | dict[str, Any]


class _Panel(NamedTuple):
    id: str
    config: Config


def merged_layout(rig: Rig, survey: SceneSurvey, topics: Collection[str], names: Sequence[str]) -> str:
    """The layout of two results in one file, marked like that of one.

    One view of the scene has both, with the clouds and the truth of the first; each camera has the image of the first
    result that has one, with what both have found in it.

    Args:
        rig: The rig of the first result.
        survey: What the first frames showed: places the eye.
        topics: Topics of the file that have messages; no other is named.
        names: What the topics of each result begin with, without the slash.
    """
    viewpoint = survey.viewpoint(aspect=1.5, fov_y_deg=FOV_Y_DEG)
    scene = _Panel("3D!scene", _scene(rig, viewpoint, topics))
    shown = scene.config["topics"]
    clouds = [topic for name in names if (topic := f"/{name}/point_cloud_combined") in topics]
    shown |= {topic: {**_CLOUD, "visible": topic == clouds[0]} for topic in clouds}
    for topic in sorted(topics):
        if topic.endswith("/fused/scene") or topic == COMPARED:
            shown[topic] = {"visible": True, "showOutlines": False}
        elif topic.endswith(("/fused/markers", "/ground_cloud", PLACED_SCENE)):
            shown[topic] = {"visible": False}
        elif _is_truth_scene(topic):  # that of one is that of the other, most often
            own = topic.removeprefix("/").partition("/")[2]
            first = next(one for name in names if (one := f"/{name}/{own}") in topics)
            shown[topic] = {"visible": topic == first, "showOutlines": False}
    cameras = []
    for camera in cameras_in_order(rig):
        images = [f"/{name}/{camera.name}/image{suffix}" for name in names for suffix in ("", "/compressed")]
        if image := next((topic for topic in images if topic in topics), None):
            found = [f"/{name}/{camera.name}/annotations" for name in names]
            mode: Config = {"imageTopic": image, "synchronize": False}
            if (calibration := f"{image.removesuffix('/compressed').removesuffix('/image')}/camera_info") in topics:
                mode["calibrationTopic"] = calibration
            mode["annotations"] = {topic: {"visible": True} for topic in found if topic in topics}
            cameras.append(_Panel(f"Image!{camera.name}", {**_titled(camera.name), "imageMode": mode, **_PRELOADED}))
    layout: Split = scene.id
    if cameras:
        ids = [panel.id for panel in cameras]
        columns = max(1, round(len(ids) ** 0.5))
        rows = [_row("row", ids[first : first + columns]) for first in range(0, len(ids), columns)]
        layout = _split("row", layout, _row("column", rows), 0.6)
    return _exported((scene, *cameras), layout)


def _exported(panels: Sequence[_Panel], layout: Split) -> str:
    tree = {
        "configById": {panel.id: panel.config for panel in panels},
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": layout,
    }
    return marked_json(json.dumps(tree, indent=2) + "\n")


def foxglove_layout(rig: Rig, survey: SceneSurvey, topics: Collection[str]) -> str:
    """The layout as JSON, marked so that an edited one is not replaced (viewers pass over the key `lidcam`).

    Args:
        rig: The rig of the run.
        survey: What the first frames showed: places the eye.
        topics: Topics of the file that have messages; no other is named.
    """
    images = [
        (camera, topic)
        for camera in cameras_in_order(rig)
        for topic in (f"/{camera.name}/image", f"/{camera.name}/image/compressed")
        if topic in topics
    ]
    panels = arrange([camera.model.width_px / camera.model.height_px for camera, _ in images])
    left = 1 - _EXTRA_SHARE
    aspect = panels.scene_aspect / left if panels.side == "right" else panels.scene_aspect * left
    viewpoint = survey.viewpoint(aspect=aspect, fov_y_deg=FOV_Y_DEG)
    scene = _Panel("3D!scene", _scene(rig, viewpoint, topics))
    extra = [_plot("objects", _OBJECT_PATHS), _plot("skew", _SKEW_PATHS), _diagnostics()]
    cameras = [_image(camera, topic, topics) for camera, topic in images]
    extra_ids, camera_ids = [panel.id for panel in extra], [panel.id for panel in cameras]
    if panels.side == "right":
        layout = _split("column", scene.id, _row("row", extra_ids), left)
    else:
        layout = _split("row", scene.id, _row("column", extra_ids), left)
    if cameras:
        columns = panels.columns
        rows = [_row("row", camera_ids[first : first + columns]) for first in range(0, len(cameras), columns)]
        grid = _row("column", rows)
        if panels.side == "right":
            layout = _split("row", layout, grid, 1 - panels.image_share)
        else:
            layout = _split("column", grid, layout, panels.image_share)
    return _exported((scene, *cameras, *extra), layout)


def _scene(rig: Rig, viewpoint: Viewpoint, topics: Collection[str]) -> Config:
    size_m = viewpoint.size_m
    settings: Mapping[str, Config] = {
        "/point_cloud_combined": _CLOUD,
        "/ground_cloud": {"colorField": "z", "colorMode": "flat", "flatColor": _GROUND_COLOR, "pointSize": 1.5},
        "/fused/scene": {"showOutlines": False},  # white ones; the objects bring their own
        **{
            f"/{camera.name}/camera_info": {"distance": _metres(size_m * 0.08), "color": _FRUSTUM_COLOR}
            for camera in rig.cameras
        },
    }
    shown = {topic: {"visible": True, **config} for topic, config in settings.items() if topic in topics}
    shown |= {topic: {"visible": True, "showOutlines": False} for topic in sorted(topics) if _is_truth_scene(topic)}
    if "/fused/markers" in topics:
        shown["/fused/markers"] = {"visible": False}  # the same objects once more, for RViz
    if PLACED_SCENE in topics:
        shown[PLACED_SCENE] = {"visible": False, "showOutlines": False}  # most of them are objects, too
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


def _is_truth_scene(topic: str) -> bool:
    """Whether truth is drawn on a topic of the file."""
    return topic.endswith(truth_scene_topic("")) and topic not in {"/fused/scene", PLACED_SCENE}


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


def _image(camera: CameraSensor, topic: str, topics: Collection[str]) -> _Panel:
    annotations = f"/{camera.name}/annotations"
    # Image and annotations have one log time. To synchronise them by stamps would hide an image without annotations.
    mode: Config = {"imageTopic": topic, "synchronize": False}
    if (calibration := f"/{camera.name}/camera_info") in topics:
        mode["calibrationTopic"] = calibration
    if annotations in topics:
        mode["annotations"] = {annotations: {"visible": True}}
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
