"""Settings of association and fusion."""

from pipeline.core.settings.model import NotNegative, SettingsModel, Share

__all__ = ["AssociateConfig", "FuseConfig"]


class AssociateConfig(SettingsModel):
    """Which 3D box is which 2D box.

    Attributes:
        min_iou: Least overlap of the projected 3D box with the 2D box.
        class_penalty: Taken from the overlap where the classes differ, before the best assignment is sought; a pair
            that is worth nothing then is never formed, so with 1 classes must agree.
    """

    min_iou: Share = 0.3
    class_penalty: NotNegative = 0.1


class FuseConfig(SettingsModel):
    """What becomes of matched and unmatched objects.

    Attributes:
        min_score: Objects with a lower score are not reported.
    """

    min_score: Share = 0.0
