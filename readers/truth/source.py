"""The true objects at a moment, and in an image, as every kind of truth gives them."""

from abc import ABC, abstractmethod
from collections.abc import Sequence

from lidcam.pipeline.evaluation.evaluation_frame import TruthBoxes2D, TruthBoxes3D
from lidcam.readers.truth.moment import Moment


class TruthSource(ABC):
    """Truth from one place.

    Sources are read once, from the beginning to the end: the stamps that they are asked for rise, apart from steps
    back of at most `STEP_BACK_NS`, and memory does not grow with the length of the truth.
    """

    description: str  # Which truth this is, for the user: `/ground_truth/objects of crossing.mcap`

    @property
    @abstractmethod
    def notes(self) -> Sequence[str]:
        """Notes for the user on what was not used, and why, one line each."""

    @abstractmethod
    def at(self, stamp_ns: int, *, frame: int) -> TruthBoxes3D | None:
        """The true objects at a time; None if the truth does not cover it.

        `frame` is the number of the result's frame that is meant, for truth that is numbered and has no stamps. The
        objects are in any frame of reference (`frame_id`): the reader of the truth brings them to the site frame by the
        transforms that were recorded.
        """

    def moment(self, stamp_ns: int, *, frame: int) -> Moment | None:
        """The objects at the time itself, with their pixels by camera, to be projected into images; see `at`."""
        boxes = self.at(stamp_ns, frame=frame)
        return None if boxes is None else Moment(boxes)

    def in_image(self, camera: str, stamp_ns: int, *, frame: int) -> TruthBoxes2D | None:
        """The true objects in the image of a camera; None if the source knows of none: `moment` is projected then."""
        del camera, stamp_ns, frame
        return None
