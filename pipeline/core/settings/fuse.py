"""Settings of association and fusion."""

from pipeline.core.settings.model import NotNegative, SettingsModel, Share

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
    """

    min_score: Share = 0.0
    min_score_unconfirmed: Share = 0.0
