"""Settings of fusion."""

from typing import Literal

from lidcam.pipeline.core.settings.model import NotNegative, Positive, SettingsModel, Share


class FuseConfig(SettingsModel):
    """Fusion of matched boxes.

    Attributes:
        min_score: Objects that are less probable are not reported. The probability is that of an object of this class
            at this place, from what all sensors say and do not say; it means the same in every recording.
        unknown: Whether what the lidars see well, and what is probably of no class, is reported as an object of class
            `unknown`: cargo on the road, animals, but also bushes, poles and walls up to the size of a bus. Its score
            grows with its points. `/lidar_camera_fused` and `lidcam evaluate` leave such objects out.
        calibration: `auto` moves lidars until they see the same surfaces, and corrects direction and clock of each
            camera by boxes of lidars and 2D boxes, in frames spread over the recording, or does not use a camera where
            these lie apart; `recorded` takes all as it was recorded.
        refine: Fit the boxes to the 2D boxes that are matched with them. Off, they stay as the lidars gave them.
        pixel_sigma_px: Standard deviation of the edges of 2D boxes that match, pixels; a recording that is long enough
            tells how much larger it is, else left and right edges get twice as much. The smaller it is, the more the
            cameras decide.
        outline_sigma: Standard deviation that is added to it, as a share of the size of the 2D box (the root of its
            area): objects are no cuboids, and detectors err in proportion.
        lidar_sigma_scale: Multiplies the standard deviations that the lidar detector gives for place and heading. Above
            1 where they are too small; the larger it is, the more the cameras decide.
    """

    min_score: Share = 0.5
    unknown: bool = False
    calibration: Literal["auto", "recorded"] = "auto"
    refine: bool = True
    pixel_sigma_px: Positive = 1.5
    outline_sigma: NotNegative = 0.04
    lidar_sigma_scale: Positive = 1.0
