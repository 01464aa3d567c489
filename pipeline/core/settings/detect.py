"""Settings of the detection in clouds and in images."""

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from pipeline.core.settings.model import Count, NotNegative, Positive, SettingsModel, Share

__all__ = ["Detect2DConfig", "Detect3DConfig"]


class Detect3DConfig(SettingsModel):
    """Detection in the cloud.

    Attributes:
        method: `cluster` needs no weights; `none` finds nothing.
        cluster_distance_m: Points this near belong together, close to a lidar.
        cluster_distance_per_m: Growth of that distance per metre of range (points thin out).
        height_weight: What a metre of height counts against a metre along the ground, when distances are taken.
        split_shares: Clusters that fit no class well are clustered again with these shares of the distance.
        clearance_m: Points lower than this above the ground are not looked at: kerbs and remains of the ground would
            join objects.
        min_points: A cluster of fewer points is noise.
        min_height_m: A cluster lower than this above the ground is a kerb or noise.
        max_bottom_m: A cluster that hovers higher than this above the ground hangs there.
        points_per_sr: Beams of one lidar per steradian: 1 / (vertical x horizontal resolution in radians); what an
            object in full view returns is judged by it.
        min_score: Boxes with a lower score go.
    """

    method: Literal["cluster", "none"] = "cluster"
    cluster_distance_m: Positive = 0.4
    cluster_distance_per_m: NotNegative = 0.01
    height_weight: Positive = 0.5
    split_shares: tuple[Annotated[float, Field(gt=0, lt=1)], ...] = (0.7,)
    clearance_m: NotNegative = 0.3
    min_points: Count = 10
    min_height_m: NotNegative = 0.5
    max_bottom_m: Positive = 1.0
    points_per_sr: Positive = 45_000.0
    min_score: Share = 0.07


class Detect2DConfig(SettingsModel):
    """Detection in images.

    Attributes:
        method: `auto`: the model if one is given, else boxes in the recording if there are any, else none.
        model: ONNX file (YOLOX layout); a path relative to the working folder.
        min_score: Boxes with a lower score go.
        nms_iou: Of two boxes of one class that overlap more than this the lower score goes.
        threads: Threads inside the network; fixed, so that results do not depend on the machine. One is cheapest: the
            other cores have the other stages to run.
    """

    method: Literal["auto", "onnx", "recorded", "none"] = "auto"
    model: Path | None = None
    min_score: Share = 0.3
    nms_iou: Share = 0.45
    threads: Count = 1
