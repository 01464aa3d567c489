"""Settings of association and fusion."""

from typing import Annotated

from pydantic import Field

from pipeline.core.settings.model import NotNegative, Positive, SettingsModel, Share

__all__ = ["AssociateConfig", "FuseConfig"]


class AssociateConfig(SettingsModel):
    """Matching of 3D boxes with 2D boxes.

    Attributes:
        min_iou: Smallest IoU of a projected 3D box and a 2D box that may match.
        class_penalty: Subtracted from the IoU if the classes differ, before the best assignment is computed. Pairs at
            or below 0 never match, so at 1 the classes must agree.
    """

    min_iou: Share = 0.3
    class_penalty: NotNegative = 0.1


class FuseConfig(SettingsModel):
    """Fusion of matched boxes.

    Attributes:
        min_score: Objects with a lower fused score are not reported.
        min_score_unconfirmed: Objects with a lower fused score are not reported if a camera with 2D boxes has them in
            view and no camera confirms them. Objects that no camera looks at, as in a run by the lidars alone, stay.
        refine: Fit the boxes to the 2D boxes that are matched with them. Off, they stay as the lidars gave them.
        pixel_sigma_px: Standard deviation of the edges of 2D boxes, pixels: how much is taken from the cameras.
        outline_sigma: Standard deviation that is added to it, as a share of the size of the 2D box (the root of its
            area): objects are no cuboids, and detectors err in proportion.
        lidar_sigma_scale: Multiplies the standard deviations that the lidar detector gives for place and heading: how
            much is taken from the lidars. Above 1 where it is too sure.
        size_sigma: Standard deviation of the length and the width of the boxes, as a share of them. 0: known exactly.
        corner_rounding: Radius of the corners of an object seen from above, as a share of its width: 2D boxes enclose
            the object, which is rounder than the box around it. 0: as large as the box.
        underside: How far above the ground an object begins at its outline, as a share of its height.
    """

    min_score: Share = 0.0
    min_score_unconfirmed: Share = 0.0
    refine: bool = True
    pixel_sigma_px: Positive = 1.5
    outline_sigma: NotNegative = 0.03
    lidar_sigma_scale: Positive = 1.0
    size_sigma: NotNegative = 0.1
    corner_rounding: Annotated[float, Field(ge=0, le=0.5)] = 0.2
    underside: Annotated[float, Field(ge=0, le=0.5)] = 0.05
