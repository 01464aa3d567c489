"""Settings of evaluation."""

from typing import Annotated, Literal

from pydantic import Field

from lidcam.pipeline.core.settings.model import Corners, CountFromZero, Positive, SettingsModel

IouThreshold = Annotated[float, Field(gt=0, le=1)]


class EvaluateConfig(SettingsModel):
    """Comparison of results with truth.

    Attributes:
        iou: IoUs of rotated boxes from which a detection counts as right in the figures named by them (`ap_bev_r40_50`
            is at 0.5).
        region: Corners x, y in the site frame of what is evaluated, or `everywhere`; null: where truth is labelled.
        max_range_m: Largest distance from the origin of the site frame that is evaluated; null: no limit.
        min_lidar_points: An object with fewer lidar points and without a pixel in an image is neither a miss nor an
            error. Truth without such counts is evaluated in any case; with 0, hidden objects are, too.
        truth_time: `stamp` compares with where an object was at the frame's stamp, `points` with where it was when the
            lidars measured it, where the truth says that.
        truth_offset_ms: Stamps of the truth minus the time at which it holds, milliseconds: its clock is another one.
        kitti_difficulty: Level of KITTI's label files; harder objects are neither a miss nor an error. `easy`: at least
            40 px high, fully visible, at most 15 % outside the image; `moderate`: 25 px, partly hidden, 30 %; `hard`:
            25 px, largely hidden, 50 %; null: all objects count.
    """

    iou: Annotated[tuple[IouThreshold, ...], Field(min_length=1)] = (0.25, 0.5, 0.7)
    region: Corners | Literal["everywhere"] | None = None
    max_range_m: Positive | None = None
    min_lidar_points: CountFromZero = 1
    truth_time: Literal["stamp", "points"] = "stamp"
    truth_offset_ms: float = 0.0
    kitti_difficulty: Literal["easy", "moderate", "hard"] | None = None
