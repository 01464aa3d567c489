"""The first positions of a viewer's eyes, chosen from the sensors and from the objects of the first frames."""

import re
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.frame import FrameResult
from lidcam.pipeline.core.geometry.boxes import box_corners
from lidcam.pipeline.core.geometry.polygons import clipped_polygon
from lidcam.pipeline.core.rig import CameraSensor, Rig
from lidcam.writers.drawing import strong_objects

SURVEYED_FRAMES = 10
"""Frames with points or objects after which the eye is placed."""

_ELEVATION_RAD, _ABOVE_RAD = np.radians(48.0), np.radians(90.0)
_MARGINS = np.array([1.3, 1.18])
"""Room for labels, beside and above."""

_CLEAR = 0.3
"""A mean of unit vectors longer than this has a direction: that of cameras all around is near zero."""

_SURROUNDED = 0.2
"""Sensors farther apart than this share of what they see stand around the scene, as at a crossing."""

_AROUND_SHARE, _NEAR_SHARE = 0.6, 0.35
"""Radius of the view, as a share of the lidars' range: of a scene that sensors surround, and around a vehicle, where
objects come past."""

_SIDES = [np.array(side) for side in ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))]
_USUAL_PERCENT, _FARTHEST = 95, 2.5
"""Objects farther off than this share of them need not be in view, nor those beyond this multiple of what the lidars
see: a few do not make all others small."""

_EMPTY_REACH_M = 5.0
_NEAREST_M = 0.1


class Viewpoint(NamedTuple):
    """An eye, in the site frame."""

    eye: F64  # (3,) metres
    target: F64  # (3,) metres; the eye looks at it
    up: F64  # (2,) unit vector, the direction on the ground that is up in the view

    @property
    def size_m(self) -> float:
        """Half the distance of the eye: the measure of axes and frusta."""
        return float(np.linalg.norm(self.eye - self.target)) / 2

    @property
    def is_above(self) -> bool:
        """Whether the eye looks straight down."""
        return bool(np.allclose(self.eye[:2], self.target[:2]))


def front_of_rig(rig: Rig) -> F64:
    """(2,) unit vector in the site frame: along the camera called front, else where the cameras look, else along x."""
    axes = np.array([_axis(camera) for camera in rig.cameras]).reshape(-1, 2)
    named = np.array([_is_front(camera.name) for camera in rig.cameras], bool)
    return _first_direction(axes[named] if named.any() else axes)


def cameras_in_order(rig: Rig) -> tuple[CameraSensor, ...]:
    """Those that look ahead from left to right, then those that look back from left to right."""
    front = front_of_rig(rig)

    def place(camera: CameraSensor) -> tuple[bool, float, str]:
        x, y = _axis(camera)
        ahead, left = x * front[0] + y * front[1], y * front[0] - x * front[1]
        azimuth = round(float(np.degrees(np.arctan2(left, ahead))), 3)
        looks_back = abs(azimuth) > 90.0
        return looks_back, azimuth % 360 if looks_back else -azimuth, camera.name

    return tuple(sorted(rig.cameras, key=place))


@dataclass
class SceneSurvey:
    """Gathers, over the first frames, what the first view should show."""

    rig: Rig  # The sensors
    span: F64 | None = None  # (2, 2) least and greatest x and y of the strong objects of all frames; None without any
    _strong: list[F64] = field(default_factory=list)
    _faint: list[F64] = field(default_factory=list)
    _reach_m: list[float] = field(default_factory=list)
    _ground_m: list[float] = field(default_factory=list)

    @property
    def ground_m(self) -> float:
        """Height of the ground in the site frame: of its points, else as the rig says."""
        return float(np.median(self._ground_m)) if self._ground_m else self.rig.ground_height_m or 0.0

    @property
    def middle(self) -> F64:
        """(3,) the middle of the sensors, metres."""
        return np.asarray(self._sensors().mean(0))

    @property
    def bounds(self) -> tuple[F64, F64]:
        """Least and greatest x and y, (2,) each, of what the lidars see."""
        center, reach_m = self._sensors().mean(0)[:2], self._usual_reach_m()
        return center - reach_m, center + reach_m

    @property
    def is_complete(self) -> bool:
        """Whether enough frames were seen."""
        return len(self._strong) >= SURVEYED_FRAMES

    def add_frame(self, result: FrameResult) -> None:
        """Take one frame in; of those after the survey is complete, how far objects go alone."""
        strong = strong_objects(result)
        if len(shown := result.fused.objects.select(strong)):
            corners = box_corners(shown.centers, shown.sizes, shown.yaws)[..., :2].reshape(-1, 2)
            corners = np.concatenate([corners, *([] if self.span is None else [self.span])])
            self.span = np.stack([corners.min(0), corners.max(0)])
        if self.is_complete:
            return
        objects, ground = result.fused.objects, result.combined.ground_cloud.xyz
        points = np.concatenate([result.combined.cloud.xyz[:, :2], ground[:, :2]])
        if len(ground):
            self._ground_m.append(float(np.median(ground[:, 2])))
        if not len(objects) and not len(points):  # the lidars may begin late
            return
        corners = box_corners(objects.centers, objects.sizes, objects.yaws)
        self._strong.append(corners[strong].reshape(-1, 3))
        self._faint.append(corners[~strong].reshape(-1, 3))
        if len(points):
            center = self._sensors().mean(0)
            distances = np.sqrt((points[:, 0] - center[0]) ** 2 + (points[:, 1] - center[1]) ** 2)
            self._reach_m.append(float(np.percentile(distances, 90)))

    def viewpoint(self, *, aspect: float, fov_y_deg: float) -> Viewpoint:
        """The eye from which sensors and objects are in view.

        A rig that looks out of one place, as a vehicle's does, is seen from behind, with what is near it and what lies
        ahead; sensors that stand around a scene are shown with all of it, from the side from which it fits best.

        The aspect is the width of the view divided by its height; the field of view is vertical.
        """
        return _nearest(*self._content(), _ELEVATION_RAD, aspect, fov_y_deg)

    def above(self, of: Viewpoint, *, aspect: float, fov_y_deg: float) -> Viewpoint:
        """The eye straight above that sees the same, and all objects; turned to the right where that fits better."""
        points, _ = self._content()
        if self.span is not None:
            limit_m = _FARTHEST * self._usual_reach_m()
            low, high = np.clip(self.span, self.middle[:2] - limit_m, self.middle[:2] + limit_m)
            points = np.concatenate(
                [points, [[x, y, self.ground_m] for x in (low[0], high[0]) for y in (low[1], high[1])]]
            )
        return _nearest(points, [of.up, np.array([-of.up[1], of.up[0]])], _ABOVE_RAD, aspect, fov_y_deg)

    def _content(self) -> tuple[F64, list[F64]]:
        """Points (N, 3) that are to be in view, and the directions (2,) along which they may be seen."""
        sensors = self._sensors()
        center = sensors.mean(0)
        spread_m = float(np.linalg.norm(sensors[:, :2] - center[:2], axis=1).max())
        reach_m = self._usual_reach_m()
        strong, faint = (np.concatenate([*found, np.zeros((0, 3))]) for found in (self._strong, self._faint))
        objects = strong if len(strong) else faint
        away = objects[:, :2] - center[:2]
        distances_m = np.linalg.norm(away, axis=1)
        usual_m = max(float(np.percentile([*distances_m, 0.0], _USUAL_PERCENT)), 0.8 * reach_m)
        shown = distances_m <= min(usual_m, _FARTHEST * (spread_m + reach_m))
        front = self._clear_front(away)
        if spread_m >= _SURROUNDED * reach_m:
            points = np.concatenate([sensors, self._round(_AROUND_SHARE * reach_m), objects[shown]])
            return points, [front] if front is not None else _SIDES
        front = front if front is not None else _SIDES[0]
        ahead = center + np.array([*front, 0.0]) * reach_m
        near = self._round(_NEAR_SHARE * reach_m)
        points = np.concatenate([sensors, [ahead], near, objects[shown & (away @ front > 0)]])
        right = np.array([front[1], -front[0], 0.0])
        aside = (points - center) @ right
        points = np.concatenate([points, points - 2 * aside[:, None] * right])  # the rig stays in the middle
        return points, [front]

    def _round(self, radius_m: float) -> F64:
        """Points (8, 3) on the ground around the sensors."""
        angles = np.arange(8) * (np.pi / 4)
        x, y, _ = self._sensors().mean(0)
        flat = [x + radius_m * np.cos(angles), y + radius_m * np.sin(angles)]
        return np.column_stack([*flat, np.full(8, self.ground_m)])

    def _usual_reach_m(self) -> float:
        return float(np.median(self._reach_m)) if self._reach_m else _EMPTY_REACH_M

    def _clear_front(self, away: F64) -> F64 | None:
        """Direction in which the cameras look, else in which the objects lie; None if that is no single direction."""
        named = any(_is_front(camera.name) for camera in self.rig.cameras)
        axes = np.array([_axis(camera) for camera in self.rig.cameras]).reshape(-1, 2)
        if named or _is_clear(axes):
            return front_of_rig(self.rig)
        return _first_direction(away) if _is_clear(away) else None

    def _sensors(self) -> F64:
        """Their places (N, 3); where the recording has boxes and no sensors, the origin of the site."""
        places = [lidar.T_site_lidar.translation for lidar in self.rig.lidars]
        places += [camera.T_camera_site.inverse().translation for camera in self.rig.cameras]
        return np.array(places or [np.zeros(3)])


def _nearest(points: F64, fronts: list[F64], elevation_rad: float, aspect: float, fov_y_deg: float) -> Viewpoint:
    """The eye that looks along one of some directions and is nearest to what is to be in view."""
    found = [Viewpoint(*_fitted(points, front, elevation_rad, aspect, fov_y_deg), front) for front in fronts]
    return min(found, key=lambda view: round(view.size_m, 3))


def _fitted(points: F64, front: F64, elevation_rad: float, aspect: float, fov_y_deg: float) -> tuple[F64, F64]:
    """Eye and target (3,): as near as all points (N, 3) are in view, seen along `front` (2,) from above."""
    ahead = np.array([*front * np.cos(elevation_rad), -np.sin(elevation_rad)])
    right = np.array([front[1], -front[0], 0.0])
    axes = np.stack([right, np.cross(right, ahead), ahead])
    seen = points @ axes.T
    across, depth = seen[:, :2], seen[:, 2:]
    slope = np.tan(np.radians(fov_y_deg) / 2) * np.array([aspect, 1.0]) / _MARGINS
    # A point is in view if |across - eye_across| <= slope (depth - eye_depth): four planes through the eye.
    low, high = (-across - slope * depth).max(0), (across - slope * depth).max(0)
    eye_depth = float((-(high + low) / (2 * slope)).min()) - _NEAREST_M
    eye = np.array([*(_middle(across[:, axis], depth[:, 0] - eye_depth) for axis in (0, 1)), eye_depth])
    distance_m = (depth.min() + depth.max()) / 2 - eye_depth
    return eye @ axes, (eye + np.array([0.0, 0.0, distance_m])) @ axes


def _middle(across: F64, depth: F64) -> float:
    """Position of an eye that sees points (N,), at depths (N,) before it, as far to one side as to the other."""
    low, high = float(across.min()), float(across.max())
    for _ in range(40):
        middle = (low + high) / 2
        if ((across - middle) / depth).max() > ((middle - across) / depth).max():
            low = middle
        else:
            high = middle
    return (low + high) / 2


def _axis(camera: CameraSensor) -> F64:
    """(2,) the camera's optical axis seen from above; zero for one that looks straight down."""
    axis = camera.T_camera_site.matrix[2, :2]
    length = float(np.linalg.norm(axis))
    return axis / length if length > 0.1 else np.zeros(2)


def _is_front(name: str) -> bool:
    words = set(re.split(r"[^a-z]+", name.lower()))
    return "front" in words and not words & {"left", "right"}


def _first_direction(vectors: F64) -> F64:
    """(2,) the common direction of vectors (N, 2) if they have one, else along x."""
    return _unit(_mean_unit(vectors)) if _is_clear(vectors) else np.array([1.0, 0.0])


def _is_clear(vectors: F64) -> bool:
    return len(vectors) > 0 and float(np.linalg.norm(_mean_unit(vectors))) > _CLEAR


def _mean_unit(vectors: F64) -> F64:
    lengths = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.asarray((vectors / np.maximum(lengths, 1e-9)).mean(0))


def _unit(vector: F64) -> F64:
    return vector / np.linalg.norm(vector)


def drawn_zones(survey: SceneSurvey) -> tuple[list[F64], F64]:
    """The zones of the rig of a survey, cut to what the lidars see where they reach into it.

    Returns:
        Corners (K, 3) of each on the ground, the first once more at the end, and the middle (N, 3) of each.
    """
    bounds = survey.bounds
    flat = [(clipped_polygon(zone.polygon_site, *bounds), zone.polygon_site) for zone in survey.rig.zones]
    shown = [clipped if len(clipped) else whole for clipped, whole in flat]
    middles = np.array([(corners.min(0) + corners.max(0)) / 2 for corners in shown]).reshape(-1, 2)
    on_ground = [np.pad(xy, ((0, 0), (0, 1)), constant_values=survey.ground_m) for xy in (*shown, middles)]
    return [np.concatenate([corners, corners[:1]]) for corners in on_ground[:-1]], on_ground[-1]


def zone_texts(rig: Rig, centers: F64) -> list[str]:
    """The text of each zone of a rig: its name, and how many objects, of centres (N, 3), it has."""
    rows = rig.place_rows(centers)
    counts = {zone.name: int((rows == row).sum()) for row, zone in enumerate(rig.counted_zones)}
    return [f"{zone.name}: {counts.get(zone.name, 'ignored')}" for zone in rig.zones]
