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
        min_score: Objects that are less probable are not reported. The probability is that of an object of this class
            at this place, from what all sensors say and do not say; it means the same in every recording.
        camera_recall: Share of large objects in plain view that the 2D detector finds; how much it speaks against an
            object that a camera should see it and says nothing. null: learned while the run goes on, for each camera
            and size.
    """

    min_score: Share = 0.5
    camera_recall: Share | None = None
