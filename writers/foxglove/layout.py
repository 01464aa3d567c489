"""A layout for Foxglove and Lichtblick in which all of a written MCAP is seen.

The form is that of an exported layout: `configById` has the settings of each panel, `layout` a tree of splits. Keys are
those of the panels of Lichtblick 1.28 (github.com/lichtblick-suite/lichtblick, packages/suite-base/src/panels), which
Foxglove shares.
"""

import json
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np

from lidcam.pipeline.core.rig import CameraSensor, Rig
from lidcam.writers.messages.scene import PLACED_SCENE, truth_scene_topic
from lidcam.writers.outputs.marks import marked_json
from lidcam.writers.panels import OBJECTS_TITLE, SKEW_TITLE, Panels, ScenePanels, arrange, scene_panels
from lidcam.writers.viewpoint import SceneSurvey, Viewpoint, cameras_in_order

FOV_Y_DEG = 45.0
"""Vertical field of view of the 3D panel."""

_EXTRA_SHARE = 0.27
"""Share of the scene's area for plots and diagnostics."""

_GROUND_COLOR, _FRUSTUM_COLOR = "#5a626eff", "#8d96a3ff"
_OBJECTS_COLOR, _CONFIRMED_COLOR, _SKEW_COLOR = "#57b5fa", "#33f259", "#ffc21a"

_SMALL_LABELS = 0.6
"""Size of labels from above, where nothing keeps them apart."""

_CLOUD = {"colorField": "z", "colorMode": "colormap", "colorMap": "turbo", "pointSize": 2}
_NO_OUTLINES = {"showOutlines": False}
_PRELOADED = {"scene": {"transforms": {"enablePreloading": True}}}

Config = dict[str, Any]
Split = str | dict[str, Any]
Direction = Literal["row", "column"]
_DIRECTIONS: tuple[Direction, Direction] = "row", "column"


def layout_path(path: Path) -> Path:
    """The path of the layout that belongs to an MCAP file: beside it."""
    return path.with_suffix(".foxglove.json")


def foxglove_layout(rig: Rig, survey: SceneSurvey, topics: Collection[str]) -> str:
    """The layout as JSON, marked so that an edited one is not replaced (viewers pass over the key `lidcam`).

    The survey places the eye; no other topics are named than these, which have messages.
    """
    images = []
    for camera in cameras_in_order(rig):
        recorded = (f"/{camera.name}/image", f"/{camera.name}/image/compressed")
        images += [(camera, topic) for topic in recorded if topic in topics][:1]
    extra = {
        "Plot!objects": _plot(OBJECTS_TITLE, _OBJECT_PATHS),
        "Plot!skew": _plot(SKEW_TITLE, _SKEW_PATHS),
        "DiagnosticSummary!lidcam": _diagnostics(),
    }
    panels, views = _arranged([camera for camera, _ in images])
    viewpoint = survey.viewpoint(aspect=views.aspect, fov_y_deg=FOV_Y_DEG)
    above = survey.above(viewpoint, aspect=views.above_aspect, fov_y_deg=FOV_Y_DEG)
    scenes = {
        "3D!scene": _scene(rig, "Scene", viewpoint, topics),
        "3D!above": _scene(rig, "From above", above, topics),
    }
    cameras = {f"Image!{camera.name}": _image(camera, topic, topics) for camera, topic in images}
    layout: Split = _split(views.direction, "3D!scene", "3D!above", views.share)
    along, across = _DIRECTIONS if panels.side == "right" else _DIRECTIONS[::-1]
    layout = _split(across, layout, _row(along, [*extra]), 1 - _EXTRA_SHARE)
    if cameras:
        ids, columns = [*cameras], panels.columns
        grid = _row("column", [_row("row", ids[first : first + columns]) for first in range(0, len(ids), columns)])
        if panels.side == "right":
            layout = _split("row", layout, grid, 1 - panels.image_share)
        else:
            layout = _split("column", grid, layout, panels.image_share)
    tree = {
        "configById": scenes | cameras | extra,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": layout,
    }
    return marked_json(json.dumps(tree, indent=2) + "\n")


def label_eye(survey: SceneSurvey) -> Viewpoint:
    """The eye of the layout of a result that has all images of its rig, for the places of labels."""
    _, views = _arranged([camera for camera in survey.rig.cameras if camera.topic])
    return survey.viewpoint(aspect=views.aspect, fov_y_deg=FOV_Y_DEG)


def _arranged(cameras: Sequence[CameraSensor]) -> tuple[Panels, ScenePanels]:
    share = 1 - _EXTRA_SHARE
    panels = arrange([camera.model.width_px / camera.model.height_px for camera in cameras])
    aspect = panels.scene_aspect
    return panels, scene_panels(aspect / share if panels.side == "right" else aspect * share)


def _scene(rig: Rig, title: str, viewpoint: Viewpoint, topics: Collection[str]) -> Config:
    size_m, is_above = viewpoint.size_m, viewpoint.is_above
    truth = sorted({one for one in topics if one.endswith(truth_scene_topic(""))} - {"/fused/scene", PLACED_SCENE})
    # The width is that of its lines.
    frustum = {"distance": _metres(size_m * 0.08), "width": _metres(size_m * 0.003), "color": _FRUSTUM_COLOR}
    settings: Mapping[str, Config] = {
        "/point_cloud_combined": _CLOUD,
        "/ground_cloud": {"colorField": "z", "colorMode": "flat", "flatColor": _GROUND_COLOR, "pointSize": 1.5},
        "/fused/scene": _NO_OUTLINES,  # white ones; the objects bring their own
        **{f"/{camera.name}/camera_info": frustum for camera in rig.cameras},
        **dict.fromkeys(truth, _NO_OUTLINES),
    }
    shown: Config = {
        topic: {"visible": not (is_above and topic.endswith("/camera_info")), **config}
        for topic, config in settings.items()
        if topic in topics
    }
    # The same objects once more, for RViz; and those that the cameras place, most of which are objects, too.
    hidden: Mapping[str, Config] = {"/fused/markers": {}, PLACED_SCENE: _NO_OUTLINES}
    shown |= {topic: {"visible": False, **config} for topic, config in hidden.items() if topic in topics}
    return {
        **_titled(title),
        "followTf": rig.site_frame,
        "followMode": "follow-pose",
        "cameraState": _camera_state(viewpoint),
        "scene": {
            "backgroundColor": "#0d1017",
            **({"labelScaleFactor": _SMALL_LABELS} if is_above else {}),
            "transforms": {
                "enablePreloading": True,  # else objects jump after a seek, says Lichtblick
                "axisScale": _metres(size_m * 0.03),
                "showLabel": False,
                "lineWidth": 0,  # from frame to frame, across the scene
            },
        },
        "transforms": {},
        "topics": shown,
        "layers": {},
        "imageMode": {},
    }


def _camera_state(viewpoint: Viewpoint) -> Config:
    """The eye in the panel's angles: `phi` from straight above, `thetaOffset` 90 for an eye that looks along x.

    From above nothing is nearer than anything else: `distance` then is the height of what is seen.
    """
    away = viewpoint.eye - viewpoint.target
    distance_m = float(np.linalg.norm(away))
    height_m = 2 * distance_m * float(np.tan(np.radians(FOV_Y_DEG) / 2))
    return {
        "perspective": not viewpoint.is_above,
        "distance": _metres(height_m if viewpoint.is_above else distance_m),
        "phi": round(float(np.degrees(np.arccos(away[2] / distance_m))), 2),
        "thetaOffset": round(float(-np.degrees(np.arctan2(-viewpoint.up[0], viewpoint.up[1]))), 2),
        "target": [0, 0, 0],
        "targetOffset": [_metres(value) for value in viewpoint.target.tolist()],
        "targetOrientation": [0, 0, 0, 1],
        "fovy": FOV_Y_DEG,
        "near": _metres(distance_m / 200),
        "far": _metres(distance_m * 200),
    }


def _image(camera: CameraSensor, topic: str, topics: Collection[str]) -> Config:
    # Image and annotations have one log time. To synchronise them by stamps would hide an image without annotations.
    mode: Config = {"imageTopic": topic, "synchronize": False}
    if (calibration := f"{topic.removesuffix('/compressed').removesuffix('/image')}/camera_info") in topics:
        mode["calibrationTopic"] = calibration
    if (annotations := f"/{camera.name}/annotations") in topics:
        mode["annotations"] = {annotations: {"visible": True}}
    return {**_titled(camera.name), "imageMode": mode, **_PRELOADED, "topics": {}}


_OBJECT_PATHS = (
    ("fused", "objects", _OBJECTS_COLOR),
    ("confirmed by cameras", "confirmed by cameras", _CONFIRMED_COLOR),
)
_SKEW_PATHS = (("skew_ms", "sync skew (ms)", _SKEW_COLOR),)


def _plot(title: str, series: Sequence[tuple[str, str, str]]) -> Config:
    same = {"enabled": True, "timestampMethod": "receiveTime", "showLine": True}
    value = '/diagnostics.status[:].values[:]{{key=="{}"}}.value'
    paths = [{"value": value.format(key), "label": label, "color": color, **same} for key, label, color in series]
    return {
        **_titled(title),
        "paths": paths,
        "minYValue": 0,
        "showLegend": False,  # it would take the room of the curves: the title names them
        "legendDisplay": "top",
        "showXAxisLabels": True,
        "showYAxisLabels": True,
        "isSynced": True,
        "xAxisVal": "timestamp",
    }


def _diagnostics() -> Config:
    config = {"minLevel": 0, "pinnedIds": [], "hardwareIdFilter": "", "topicToRender": "/diagnostics"}
    return {**_titled("Diagnostics"), **config, "sortByLevel": True}


def _titled(title: str) -> Config:
    return {"foxglovePanelTitle": title, "lichtblickPanelTitle": title}


def _row(direction: Direction, parts: Sequence[Split]) -> Split:
    """Parts of equal size side by side, or one below the other."""
    if len(parts) == 1:
        return parts[0]
    return _split(direction, parts[0], _row(direction, parts[1:]), 1 / len(parts))


def _split(direction: Direction, first: Split, second: Split, share: float) -> Split:
    return {"first": first, "second": second, "direction": direction, "splitPercentage": round(100 * share, 1)}


def _metres(value: float) -> float:
    return round(float(value), 3)
