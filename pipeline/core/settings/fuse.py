"""Settings of association and fusion."""

from typing import Annotated, ClassVar

from pydantic import Field

from lidcam.pipeline.core.settings.model import NotNegative, Positive, SettingsModel, Share


class AssociateConfig(SettingsModel):
    """Matching of 3D boxes with 2D boxes.

    A pair matches if it is likelier that both are one object than that they are two. How likely depends on how far the
    2D box lies from where the 3D box is projected to (in the deviations that the settings here and the covariance of
    the 3D box allow), on both classes, on the 2D box's score, and on how much of the object others hide.

    Attributes:
        min_giou: Smallest generalised IoU of a projected 3D box and a 2D box that may match, from -1 to 1: the IoU less
            the share of the rectangle around both that neither fills. Below 0, boxes of small objects may match that
            lie side by side, where the calibration is off.
        gate: Largest distance of a pair that may match, in standard deviations.
        pixel_sigma_px: Standard deviation of the edges of 2D boxes, pixels. Larger than `fuse.pixel_sigma_px`: a wrong
            class or a hidden part moves edges further, and such pairs should match as well.
        outline_sigma: Standard deviation that is added to it, as a share of the width or height of the projected box.
            Larger than `fuse.outline_sigma`: the size of the 3D box may be wrong, too.
        calibration_sigma_deg: Standard deviation of the direction in which a camera looks.
        any_class: Share of the classes that detectors give which say nothing of the object. Beyond it, classes are
            confused by their sizes: trucks with buses, riders with pedestrians.
        unseen_boxes: 2D boxes in an image that belong to no 3D box, as a rule. The more there are, the better a pair
            has to fit.
    """

    GONE: ClassVar = {
        "min_iou": "pairs are no longer chosen by their IoU; leave it out, or see associate.min_giou, which is on "
        "another scale: the generalised IoU, from -1 to 1",
        "class_penalty": "leave it out: how much another class counts follows from the sizes of the classes and "
        "associate.any_class",
    }

    min_giou: Annotated[float, Field(ge=-1, le=1)] = -0.3
    gate: Positive = 6.0
    pixel_sigma_px: Positive = 2.0
    outline_sigma: Positive = 0.15
    calibration_sigma_deg: NotNegative = 0.5
    any_class: Annotated[float, Field(gt=0, le=1)] = 0.01
    unseen_boxes: Positive = 3.0


class FuseConfig(SettingsModel):
    """Fusion of matched boxes.

    Attributes:
        min_score: Objects that are less probable are not reported. The probability is that of an object of this class
            at this place, from what all sensors say and do not say; it means the same in every recording.
        camera_recall: Share of large objects in plain view that the 2D detector finds; how much it speaks against an
            object that a camera should see it and says nothing. null: learned while the run goes on, for each camera
            and size.
        unknown: Whether what the lidars see well, and what is probably of no class, is reported as an object of class
            `unknown`: cargo on the road, animals, but also bushes, poles and walls up to the size of a bus. Its score
            grows with its points. `/lidar_camera_fused` and `lidcam evaluate` leave such objects out.
        refine: Fit the boxes to the 2D boxes that are matched with them. Off, they stay as the lidars gave them.
        pixel_sigma_px: Standard deviation of the edges of 2D boxes that match, pixels. The smaller it is, the more the
            cameras decide.
        outline_sigma: Standard deviation that is added to it, as a share of the size of the 2D box (the root of its
            area): objects are no cuboids, and detectors err in proportion.
        heading_sigma_deg: Standard deviation of the heading in which an object appears in images: as it is no cuboid, a
            fitted cuboid is turned.
        lidar_sigma_scale: Multiplies the standard deviations that the lidar detector gives for place and heading. Above
            1 where they are too small; the larger it is, the more the cameras decide.
        size_sigma: Largest standard deviation of the length and the width of the boxes, as a share of them; it is less
            where the covariance of a box says that the lidars saw both ends. 0: known exactly.
        corner_rounding: Radius of the corners of a car seen from above, as a share of its width: 2D boxes enclose the
            object, which is rounder than the box around it. Higher vehicles have sharper corners, people on foot are
            round, and who rides has thin wheels in front and behind. 0: all are as large as the box.
        underside: How far above the ground an object begins at its outline, as a share of its height.
        cabin: How much shorter and narrower than its body the roof of an object is that is lower than wide, as a share.
    """

    GONE: ClassVar = {
        "min_score_unconfirmed": "leave it out: fuse.min_score is a probability, with cameras and without",
    }

    min_score: Share = 0.5
    camera_recall: Share | None = None
    unknown: bool = False
    refine: bool = True
    pixel_sigma_px: Positive = 1.5
    outline_sigma: NotNegative = 0.04
    heading_sigma_deg: NotNegative = 5.0
    lidar_sigma_scale: Positive = 1.0
    size_sigma: NotNegative = 0.15
    corner_rounding: Annotated[float, Field(ge=0, le=0.5)] = 0.25
    underside: Annotated[float, Field(ge=0, le=0.5)] = 0.06
    cabin: Annotated[float, Field(ge=0, lt=1)] = 0.4
