"""Settings of the combination of clouds."""

from typing import Annotated

from pydantic import Field

from pipeline.core.settings.model import Count, NotNegative, Positive, SettingsModel

__all__ = ["CombineConfig", "GroundConfig", "MotionConfig", "OutlierConfig"]


class MotionConfig(SettingsModel):
    """Motion compensation of clouds.

    Attributes:
        enabled: Off leaves points where they were measured.
        topic: nav_msgs/Odometry of the site or vehicle frame; empty: found by its child frame, else by tf.
        max_extrapolation_s: Points measured longer than this before the first or after the last known pose leave their
            cloud uncompensated.
        max_gap_s: Poses further apart than this say nothing of the motion between them.
    """

    enabled: bool = True
    topic: str = ""
    max_extrapolation_s: NotNegative = 0.2
    max_gap_s: Positive = 1.0


class OutlierConfig(SettingsModel):
    """Statistical outlier removal by PCL's rule.

    Attributes:
        enabled: Off keeps all points.
        neighbors: Nearest neighbours that the mean distance is taken over, without the point itself.
        std_ratio: Points further than mean + std_ratio x standard deviation go.
    """

    enabled: bool = True
    neighbors: Count = 10
    std_ratio: float = 1.0


class GroundConfig(SettingsModel):
    """Ground removal by a RANSAC plane that is held to be ground.

    Attributes:
        enabled: Off keeps the ground.
        distance_m: Points nearer to the plane than this belong to it.
        max_tilt_deg: Largest angle between the plane's normal and the site's z axis.
        height_tolerance_m: Largest distance, at the site's origin, from the rig's ground height where that is known.
        iterations: Planes that are tried.
        seed: Of the random choice.
    """

    enabled: bool = True
    distance_m: Positive = 0.2
    max_tilt_deg: Annotated[float, Field(gt=0, lt=90)] = 10.0
    height_tolerance_m: Positive = 0.5
    iterations: Count = 200
    seed: Annotated[int, Field(ge=0)] = 0


class CombineConfig(SettingsModel):
    """How clouds become one.

    Attributes:
        min_range_m: Points nearer to their lidar go (the rig itself).
        max_range_m: Points further from their lidar go.
        motion: Motion compensation.
        outliers: Outlier removal.
        ground: Ground removal.
    """

    min_range_m: NotNegative = 0.0
    max_range_m: Positive = 200.0
    motion: MotionConfig = MotionConfig()
    outliers: OutlierConfig = OutlierConfig()
    ground: GroundConfig = GroundConfig()
