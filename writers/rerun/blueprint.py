"""The layout of a Rerun recording: its views, and the eyes of the 3D views."""

from typing import Any, Literal

import rerun.blueprint as rrb

from lidcam.pipeline.core.rig import CameraSensor, Rig
from lidcam.writers.panels import SKEW_TITLE, WINDOW_PX, Panels, arrange, scene_panels
from lidcam.writers.viewpoint import SceneSurvey, Viewpoint, cameras_in_order

BACKGROUND = (13, 16, 23)
FOV_Y_DEG = 55.0
"""Vertical field of view of Rerun's eye."""

_PLOTS_SHARE = 0.55
"""Share of the height for plots and legend."""

FIXED = "world/fixed"
WAY = "world/fixed/way"
TRACKS, VEHICLE, LEGEND = "world/tracks", "world/vehicle", "legend"
PLACED = "world/detections/cameras"
"""Boxes that the cameras alone place in 3D."""

LABELS, NUMBERS = "world/labels", "world/numbers"
"""Texts of the objects: in perspective, and from above, where there is room for the numbers of the tracks."""

LOG = "log"
"""Warnings."""

TIMELINES = ("stamp", "frame")


def camera_path(camera: CameraSensor) -> str:
    """Entity path of a camera: its pinhole, with image and boxes below it."""
    return f"world/cameras/{camera.name}"


def image_width_points(rig: Rig) -> float:
    """Width of an image in points of the screen, in a window of the usual size."""
    panels = _panels(rig)
    width = WINDOW_PX[0] * (panels.image_share if panels.side == "right" else 1 - panels.plot_share)
    return max(width / panels.columns, 1.0)


def place_eye(survey: SceneSurvey) -> Viewpoint:
    """The eye from which what was seen so far is in view."""
    return survey.viewpoint(aspect=scene_panels(_panels(survey.rig).scene_aspect).aspect, fov_y_deg=FOV_Y_DEG)


def blueprint(survey: SceneSurvey, viewpoint: Viewpoint, *, is_tracked: bool) -> rrb.Blueprint:
    """The scene, the images in their aspects, in the order in which the cameras look around, and the plots."""
    panels, cameras = _panels(survey.rig), _shown(survey.rig)
    scene, plots = _scene(survey, viewpoint, panels.scene_aspect), _plots(panels, is_tracked=is_tracked)
    is_right = panels.side == "right"
    layout: Any = rrb.Tabs(scene, rrb.Vertical(plots, name="Plots"), active_tab=0)
    if cameras:
        images: Any = rrb.Grid(*map(_image_view, cameras), grid_columns=panels.columns)
        if panels.plot_share:
            layout = scene
            images = _shared("column" if is_right else "row", images, plots, 1 - panels.plot_share)
        if is_right:
            layout = _shared("row", layout, images, 1 - panels.image_share)
        else:
            layout = _shared("column", images, layout, panels.image_share)
    return rrb.Blueprint(
        layout,
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline="stamp"),
        auto_layout=False,
        auto_views=False,
    )


def _shared(direction: Literal["row", "column"], first: Any, second: Any, share: float, name: str = "") -> Any:
    """Two parts side by side or one above the other, of which the first has this share."""
    shares = [share, 1 - share]
    if direction == "row":
        return rrb.Horizontal(first, second, column_shares=shares, name=name or None)
    return rrb.Vertical(first, second, row_shares=shares, name=name or None)


def _shown(rig: Rig) -> list[CameraSensor]:
    return [camera for camera in cameras_in_order(rig) if camera.topic]


def _panels(rig: Rig) -> Panels:
    return arrange([camera.model.width_px / camera.model.height_px for camera in _shown(rig)])


def _scene(survey: SceneSurvey, viewpoint: Viewpoint, aspect: float) -> Any:
    """The scene in perspective and from above."""
    split = scene_panels(aspect)
    above = survey.above(viewpoint, aspect=split.above_aspect, fov_y_deg=FOV_Y_DEG)
    cameras = _shown(survey.rig)
    flat = [f"- {camera_path(camera)}/{leaf}" for camera in cameras for leaf in ("boxes", "labels", "objects")]
    no_sensors = ["- $origin/cameras/**", "- $origin/lidars/**"]
    oblique = _scene_view("Scene", viewpoint, (0.0, 0.0, 1.0), [*flat, f"- {NUMBERS}"])
    flat_view = _scene_view("From above", above, (*above.up.tolist(), 0.0), [*no_sensors, f"- {LABELS}/**"])
    return _shared(split.direction, oblique, flat_view, split.share, "Scene")


def _scene_view(name: str, view: Viewpoint, up: tuple[float, ...], without: list[str]) -> rrb.Spatial3DView:
    start, end = rrb.TimeRangeBoundary.infinite(), rrb.TimeRangeBoundary.cursor_relative()
    past = [rrb.VisibleTimeRange(timeline, start=start, end=end) for timeline in TIMELINES]
    return rrb.Spatial3DView(
        name=name,
        origin="world",
        contents=["$origin/**", *without],
        background=BACKGROUND,
        line_grid=False,
        eye_controls=rrb.EyeControls3D(position=view.eye, look_target=view.target, eye_up=up),
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


def _plots(panels: Panels, *, is_tracked: bool) -> Any:
    """Speeds and numbers of objects, warnings and skew in tabs; beside them what the colours mean."""
    hidden = rrb.PlotLegend(visible=False)  # it would cover the curves
    counts = ["$origin/objects", "$origin/confirmed"]
    speeds = rrb.TimeSeriesView(name="Speeds (m/s)", origin=TRACKS, contents="$origin/**", plot_legend=hidden)
    objects = rrb.TimeSeriesView(name="Objects", origin="metrics", contents=counts)
    skew = rrb.TimeSeriesView(name=SKEW_TITLE, origin="metrics", contents="$origin/skew_ms", plot_legend=hidden)
    columns = rrb.TextLogColumns(timeline_columns=["frame"], text_log_columns=["loglevel", "body"])
    log = rrb.TextLogView(name="Warnings", origin=LOG, columns=columns)
    plots = rrb.Tabs(*[speeds] * is_tracked, objects, log, skew, active_tab=0)
    bounds = rrb.VisualBounds2D(x_range=[0.0, 2.0], y_range=[0.0, 1.2])
    legend = rrb.Spatial2DView(name="Colours", origin=LEGEND, background=BACKGROUND, visual_bounds=bounds)
    is_narrow = panels.side == "top" and panels.plot_share
    return _shared("column" if is_narrow else "row", plots, legend, _PLOTS_SHARE)
