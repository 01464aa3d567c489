"""Settings for combining clouds."""

from typing import Annotated

from pydantic import Field

from lidcam.pipeline.core.settings.model import NotNegative, Positive, SettingsModel


class MotionConfig(SettingsModel):
    """Motion compensation of clouds.

    Attributes:
        enabled: If off, points stay where they were measured.
        topic: nav_msgs/Odometry topic of the site or vehicle frame. If empty, it is found by its child frame; without
            one, tf is used.
    """

    enabled: bool = True
    topic: str = ""


class OutlierConfig(SettingsModel):
    """Statistical outlier removal, as in PCL, of what is written and shown; for detection, removal of rain and snow.

    Attributes:
        enabled: If off, all points are kept.
        std_ratio: Points whose average distance to their 10 nearest neighbours exceeds mean + std_ratio x standard
            deviation of the cloud are removed.
    """

    enabled: bool = True
    std_ratio: float = 1.0


class GroundConfig(SettingsModel):
    """Ground removal by a plane found with RANSAC.

    Detection, and the placing of what only cameras see, also account for slopes, crests and kerbs.

    Attributes:
        enabled: If off, ground points are kept.
        distance_m: Points at most this far from the plane are ground.
        max_tilt_deg: Largest angle between the plane's normal and the site's z axis.
        height_tolerance_m: Largest distance, at the site's origin, from the rig's ground height if that is known.
    """

    enabled: bool = True
    distance_m: Annotated[float, Field(gt=0, le=1000)] = 0.2
    max_tilt_deg: Annotated[float, Field(gt=0, lt=90)] = 10.0
    height_tolerance_m: Positive = 0.5


class CombineConfig(SettingsModel):
    """Combining the clouds of all lidars.

    Attributes:
        min_range_m: Points nearer to their lidar are removed; excludes the rig itself.
        max_range_m: Points further from their lidar are removed.
        motion: Motion compensation.
        outliers: Outlier removal.
        ground: Ground removal.
    """

    min_range_m: NotNegative = 0.0
    max_range_m: Positive = 200.0
    motion: MotionConfig = MotionConfig()
    outliers: OutlierConfig = OutlierConfig()
    ground: GroundConfig = GroundConfig()
