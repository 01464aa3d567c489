"""The frames of a result with their messages, and with the truth, as every data set is made of them."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from itertools import zip_longest

from lidcam.evaluation.frames import EvaluationFrames
from lidcam.pipeline.core.arrays import U8, Bools
from lidcam.pipeline.core.errors import MessageError, RecordingError
from lidcam.pipeline.core.messages import RawMessage
from lidcam.pipeline.core.rig import CameraSensor
from lidcam.pipeline.evaluation.evaluation_frame import EvaluationFrame
from lidcam.readers.location import Location
from lidcam.readers.messages.image import decode_any_image
from lidcam.readers.results.result import SOURCE_TOPICS, Result
from lidcam.readers.truth.open import open_truth
from lidcam.readers.truth.site import SitePoses

FUSED = SOURCE_TOPICS["fused"]


@dataclass(frozen=True, slots=True)
class ExportOptions:
    """The content of an export."""

    confirmed: bool = False  # Whether only objects that a camera confirms are
    every: int = 1  # Step between exported frames
    camera: str = ""  # Name of the camera where a format has one; empty: the first with images
    truth: tuple[Location, ...] = ()  # Recordings or labels with the truth; empty: the truth in the result


class ResultFrames:
    """The frames of a result, or every Nth; `left_out` counts by reason, and `stack` closes the truth.

    Attributes:
        recorded: Topics with messages.
        images: Cameras by the topic of their images.
    """

    def __init__(self, result: Result, options: ExportOptions, left_out: Counter[str], stack: ExitStack) -> None:
        self._result, self._options, self._left_out = result, options, left_out
        self.recorded = {info.topic for info in result.recording.topics if info.message_count}
        topics = [
            (f"/{camera.name}/image{suffix}", camera) for camera in result.rig.cameras for suffix in ("", "/compressed")
        ]
        self.images: Mapping[str, CameraSensor] = {topic: one for topic, one in topics if topic in self.recorded}
        self._without_images = [one.name for one in result.rig.cameras if one not in self.images.values()]
        self._truth = stack.enter_context(open_truth(result, options.truth))
        self._poses = SitePoses(self._truth.poses, result.rig, result.config)
        self._evaluated = EvaluationFrames(result, self._truth)

    @property
    def has_truth(self) -> bool:
        """Whether the true objects are known."""
        return self._truth.source is not None

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes on the result for the user."""
        of_truth = () if self._truth.source is None else (f"truth: {self._truth.source.description}",)
        missing, name = self._without_images, self._result.path.name
        no_images = f"{name}: has no images of {', '.join(missing)}; output.images=true keeps those of the recording"
        return (*self._result.notes, *of_truth, *([no_images] if missing else []))

    def frames_and_messages(self, topics: Sequence[str]) -> Iterator[tuple[EvaluationFrame, Mapping[str, RawMessage]]]:
        """The frames with their messages of these topics; those that the truth does not cover are counted."""
        beside = self._result.messages_of_frames([FUSED, *topics])
        for found, messages in zip_longest(self._evaluated, beside):
            fused = None if messages is None else messages.get(FUSED)
            if found is None or fused is None or fused.stamp_ns != found.stamp_ns:
                raise RecordingError(
                    f"{self._result.path}: is damaged: what belongs to a frame does not stand together; process the "
                    "recording anew"
                )
            if found.index % self._options.every:
                continue
            if self._truth.source is not None and found.truth is None:
                self._left_out["frames without truth at their time"] += 1
                continue
            yield found, messages

    def pixels_of(self, message: RawMessage, camera: CameraSensor) -> U8 | None:
        """(H, W, 3) uint8, the image as recorded, red first; None, and counted, if it cannot be decoded."""
        try:
            return decode_any_image(message, limits=self._result.config.limits).rgb
        except MessageError:
            self._left_out[f"images of {camera.name} that cannot be decoded"] += 1
            return None

    def count(self, reason: str, rows: Bools) -> None:
        """Count the rows that are left out."""
        if rows.any():
            self._left_out[reason] += int(rows.sum())
