"""Settings of the comparison of two results."""

from typing import Annotated

from pydantic import Field

from pipeline.core.settings.model import NotNegative, Positive, SettingsModel, Share

__all__ = ["CompareConfig"]


class CompareConfig(SettingsModel):
    """Comparison of two results: what still counts as equal, and what as the same object.

    Attributes:
        position_m: Farthest that the centre of an object may have moved.
        yaw_deg: Largest turn; an object that points the other way has turned by 180 degrees.
        size_m: Largest difference in length, width or height.
        score: Largest difference of scores, of objects and of 2D boxes.
        pixels: Farthest that an edge of a 2D box may have moved.
        gate: Up to which distance two objects can be the same one, in lengths of the class (`classes.N.size_m`); beyond
            it one is lost and the other new.
        min_iou: Smallest IoU of two 2D boxes that can be the same one.
        stamp_s: Largest difference of stamps of what can be the same frame.
    """

    position_m: NotNegative = 0.01
    yaw_deg: Annotated[float, Field(ge=0, le=180)] = 0.5
    size_m: NotNegative = 0.01
    score: Share = 0.01
    pixels: NotNegative = 1.0
    gate: Positive = 1.0
    min_iou: Share = 0.3
    stamp_s: NotNegative = 0.01
