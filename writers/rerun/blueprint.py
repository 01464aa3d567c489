"""The layout of a Rerun recording: its views, and the camera of the 3D view."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from pipeline.core.arrays import F64
from pipeline.core.clouds import CombinedCloud
from pipeline.core.rig import CameraSensor, Rig

__all__ = ["SceneScale", "blueprint", "camera_path"]

BACKGROUND = (13, 16, 23)
_WIDE = 1.9
"""Images of at least this aspect ratio are placed above the scene, others beside it."""


@dataclass(frozen=True, slots=True)
class SceneScale:
    """The extent of a scene, a street or a table, from the points of the first frame.

    Attributes:
        center: (3,) metres in the site frame: mean of the lidars' positions, at the median height of the points.
        radius_m: Radius of the part shown: spread of the lidars plus the distance within which 75 % of the points are.
        low_m: Height where the colours of the cloud begin: 2nd percentile.
        high_m: Height where they end: 98th percentile.
    """

    center: F64
    radius_m: float
    low_m: float
    high_m: float

    @classmethod
    def of(cls, combined: CombinedCloud, rig: Rig) -> "SceneScale":
        """The scale of one frame; without points that of a room."""
        points = np.concatenate([combined.cloud.xyz, combined.ground_cloud.xyz]).astype(np.float64)
        lidars = np.array([lidar.T_site_lidar.translation for lidar in rig.lidars]).reshape(-1, 3)
        center = lidars.mean(0) if len(lidars) else np.zeros(3)
        if not len(points):
            return cls(center, 5.0, 0.0, 2.0)
        center[2] = np.median(points[:, 2])
        spread = float(np.linalg.norm(lidars[:, :2] - center[:2], axis=1).max(initial=0.0))
        reach = float(np.percentile(np.linalg.norm(points[:, :2] - center[:2], axis=1), 75))
        heights = combined.cloud.xyz[:, 2] if len(combined.cloud) else points[:, 2]
        low, high = np.percentile(heights, [2, 98]).tolist()
        return cls(center, max(spread + reach, 0.1), low, max(high, low + 0.01))


def camera_path(camera: CameraSensor) -> str:
    """Entity path of a camera: its pinhole, with image and boxes below it."""
    return f"world/cameras/{camera.name}"


def blueprint(rig: Rig, scale: SceneScale) -> rrb.Blueprint:
    """The scene on the left and a grid of images on the right; wide images go above the scene."""
    shown = [camera for camera in rig.cameras if camera.topic]
    images = [_image_view(camera) for camera in shown]
    scene = rrb.Tabs(_scene_view(scale, shown), _plots(), active_tab=0)
    if not images:
        layout: Any = scene
    elif len(images) <= 2 and all(c.model.width_px >= _WIDE * c.model.height_px for c in shown):
        layout = rrb.Vertical(rrb.Horizontal(*images), scene, row_shares=[2, 3])
    else:
        columns = 1 if len(images) <= 2 else 2
        layout = rrb.Horizontal(scene, rrb.Grid(*images, grid_columns=columns), column_shares=[3, 2])
    return rrb.Blueprint(
        layout,
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline="stamp"),
        auto_layout=False,
        auto_views=False,
    )


def _scene_view(scale: SceneScale, shown: Sequence[CameraSensor]) -> rrb.Spatial3DView:
    # Seen from behind and above, looking along x: forward for a vehicle (REP 103).
    eye = scale.center + scale.radius_m * np.array([-1.05, 0.0, 0.75])
    target = scale.center + scale.radius_m * np.array([0.3, 0.0, -0.1])
    flat = [f"- {camera_path(camera)}/{leaf}" for camera in shown for leaf in ("boxes", "projected")]
    return rrb.Spatial3DView(
        name="Scene",
        origin="world",
        contents=["$origin/**", *flat],
        background=BACKGROUND,
        line_grid=False,
        eye_controls=rrb.EyeControls3D(position=eye, look_target=target, eye_up=(0.0, 0.0, 1.0)),
    )


def _image_view(camera: CameraSensor) -> rrb.Spatial2DView:
    """The image with its 2D boxes and the 3D objects.

    Rerun projects without lens distortion: for a distorted image the projected rectangles are shown instead.
    """
    model = camera.model
    straight = model.model != "equidistant" and not model.distortion.any()
    objects = ["world/objects"] if straight else []
    hidden = ["- $origin/projected"] if straight else []
    return rrb.Spatial2DView(
        name=camera.name,
        origin=camera_path(camera),
        contents=["$origin/**", *objects, *hidden],
        background=BACKGROUND,
        overrides={"world/objects": rr.Boxes3D.from_fields(show_labels=False, fill_mode="MajorWireframe")},
        visual_bounds=rrb.VisualBounds2D(x_range=[0, model.width_px], y_range=[0, model.height_px]),
    )


def _plots() -> rrb.TimeSeriesView:
    return rrb.TimeSeriesView(name="Objects and skew", origin="metrics", contents="$origin/**")
