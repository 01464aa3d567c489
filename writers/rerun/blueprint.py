"""The layout of a Rerun recording: its views, and the eye of the 3D view."""

from typing import Any

import rerun.blueprint as rrb

from pipeline.core.rig import CameraSensor, Rig
from writers.panels import Panels, arrange
from writers.viewpoint import SceneSurvey, Viewpoint, cameras_in_order

__all__ = ["FIXED", "PLACED", "WAY", "blueprint", "camera_path", "place_eye"]

BACKGROUND = (13, 16, 23)
FOV_Y_DEG = 55.0
"""Vertical field of view of Rerun's eye."""

_TWO_PLOTS_SHARE = 0.3

FIXED = "world/fixed"
WAY = "world/fixed/way"
PLACED = "world/detections/cameras"
"""Boxes that the cameras alone place in 3D."""

TIMELINES = ("stamp", "frame")


def camera_path(camera: CameraSensor) -> str:
    """Entity path of a camera: its pinhole, with image and boxes below it."""
    return f"world/cameras/{camera.name}"


def place_eye(survey: SceneSurvey) -> Viewpoint:
    """The eye from which what was seen so far is in view."""
    return survey.viewpoint(aspect=_panels(survey.rig).scene_aspect, fov_y_deg=FOV_Y_DEG)


def blueprint(rig: Rig, viewpoint: Viewpoint) -> rrb.Blueprint:
    """The scene and the images, in their aspects and in the order in which the cameras look around."""
    panels, cameras = _panels(rig), _shown(rig)
    scene, plots = _scene_view(viewpoint, cameras), _plots(panels)
    layout: Any = rrb.Tabs(scene, rrb.Vertical(plots, name="Plots"), active_tab=0)
    if cameras:
        images: Any = rrb.Grid(*map(_image_view, cameras), grid_columns=panels.columns)
        beside = [1 - panels.plot_share, panels.plot_share]
        if panels.plot_share:
            layout = scene
        if panels.side == "right":
            images = rrb.Vertical(images, plots, row_shares=beside) if panels.plot_share else images
            layout = rrb.Horizontal(layout, images, column_shares=[1 - panels.image_share, panels.image_share])
        else:
            images = rrb.Horizontal(images, plots, column_shares=beside) if panels.plot_share else images
            layout = rrb.Vertical(images, layout, row_shares=[panels.image_share, 1 - panels.image_share])
    return rrb.Blueprint(
        layout,
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline="stamp"),
        auto_layout=False,
        auto_views=False,
    )


def _shown(rig: Rig) -> list[CameraSensor]:
    return [camera for camera in cameras_in_order(rig) if camera.topic]


def _panels(rig: Rig) -> Panels:
    return arrange([camera.model.width_px / camera.model.height_px for camera in _shown(rig)])


def _scene_view(viewpoint: Viewpoint, cameras: list[CameraSensor]) -> rrb.Spatial3DView:
    flat = [f"- {camera_path(camera)}/{leaf}/**" for camera in cameras for leaf in ("boxes", "objects")]
    past = [
        rrb.VisibleTimeRange(
            timeline, start=rrb.TimeRangeBoundary.infinite(), end=rrb.TimeRangeBoundary.cursor_relative()
        )
        for timeline in TIMELINES
    ]
    return rrb.Spatial3DView(
        name="Scene",
        origin="world",
        contents=["$origin/**", *flat],
        background=BACKGROUND,
        line_grid=False,
        eye_controls=rrb.EyeControls3D(position=viewpoint.eye, look_target=viewpoint.target, eye_up=(0.0, 0.0, 1.0)),
        overrides={WAY: rrb.VisibleTimeRanges(past), PLACED: rrb.EntityBehavior(visible=False)},
    )


def _image_view(camera: CameraSensor) -> rrb.Spatial2DView:
    """The image with its 2D boxes, and the 3D boxes as the lens bends them (Rerun itself knows no distortion)."""
    return rrb.Spatial2DView(
        name=camera.name,
        origin=camera_path(camera),
        contents="$origin/**",
        background=BACKGROUND,
        visual_bounds=rrb.VisualBounds2D(x_range=[0, camera.model.width_px], y_range=[0, camera.model.height_px]),
    )


def _plots(panels: Panels) -> rrb.Container:
    """Numbers of objects and milliseconds: one below the other where there is room."""
    objects = rrb.TimeSeriesView(name="Objects", origin="metrics", contents=["$origin/objects", "$origin/confirmed"])
    skew = rrb.TimeSeriesView(name="Sync skew", origin="metrics", contents="$origin/skew_ms")
    if panels.plot_share >= _TWO_PLOTS_SHARE:
        return rrb.Vertical(objects, skew)
    return rrb.Tabs(objects, skew, active_tab=0)
