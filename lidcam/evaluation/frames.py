"""The frames of a result beside the truth, in the site frame and at each frame's time."""

from collections.abc import Iterator
from dataclasses import replace

from lidcam.pipeline.evaluation.evaluation_frame import (
    EvaluationFrame,
    ImageBoxes,
    ResultFrame,
    SourceBoxes,
    TruthBoxes2D,
    TruthBoxes3D,
)
from lidcam.pipeline.fusion.zones import is_reported
from lidcam.readers.notes import Notes
from lidcam.readers.results.result import Result
from lidcam.readers.truth.moment import projected_truth
from lidcam.readers.truth.open import OpenTruth
from lidcam.readers.truth.site import SitePoses, boxes_in_site

NOT_COVERED = "frames without truth at their time"
NO_POSE = "frames without truth, because where the site frame was at their time is not recorded"

ADRIFT = "no speeds are compared: the sensors move, and where to is not recorded"


class EvaluationFrames:
    """An open result beside the truth, or without any."""

    def __init__(self, result: Result, truth: OpenTruth) -> None:
        self._result, self._truth, self._reason = result, truth.source, truth.reason
        self._poses = SitePoses(truth.poses, result.rig, result.config)
        self._offset_ns = round(result.config.evaluate.truth_offset_ms * 1e6)
        self._cameras = {camera.name: camera for camera in result.rig.cameras}
        self._notes = Notes()

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes for the user about what was read, one line each."""
        no_truth, path = f"no truth: {self._reason}", self._result.path
        adrift = (ADRIFT,) if self._result.is_adrift and self._truth is not None else ()
        of_truth = (no_truth,) if self._truth is None else (f"truth: {self._truth.description}", *self._truth.notes)
        lines = (*self._result.notes, *of_truth, *adrift, *self._notes.lines())
        return tuple(line.replace(str(path), path.name) for line in lines)  # a page shows no folders

    def __iter__(self) -> Iterator[EvaluationFrame]:
        """The frames in order; to be read once.

        Raises FrameError if nothing recorded joins the truth's frame with the site frame, and RecordingError if a file
        cannot be read.
        """
        for frame in self._result.frames():
            # Without recorded motion the site frame would stand still; where it does not, its place is not known.
            T_fixed_site = None if self._result.is_adrift else self._poses.T_fixed_site(frame.stamp_ns)
            truth = self._truth_at(frame)
            shown = {name: self.in_image(name, found.stamp_ns, frame.index) for name, found in frame.cameras.items()}
            yield EvaluationFrame(
                index=frame.index,
                stamp_ns=frame.stamp_ns,
                truth=truth,
                sources={name: self._where_reported(source) for name, source in frame.sources.items()},
                images={name: ImageBoxes(found, shown[name]) for name, found in frame.cameras.items()},
                skew_ns=frame.skew_ns,
                T_fixed_site=None if T_fixed_site is None else T_fixed_site.matrix,
                sync=frame.sync,
            )

    def _where_reported(self, source: SourceBoxes) -> SourceBoxes:
        """The objects of a source, of which those where the zones let nothing be reported are ignored."""
        is_ignored = ~is_reported(source.boxes.centers, self._result.rig.zones)
        return replace(source, is_ignored=is_ignored) if is_ignored.any() else source

    def _truth_at(self, frame: ResultFrame) -> TruthBoxes3D | None:
        if self._truth is None:
            return None
        boxes = self._truth.at(frame.stamp_ns + self._offset_ns, frame=frame.index)
        if boxes is None:
            self._notes.add_note(NOT_COVERED)
            return None
        in_site = self._in_site(boxes, frame.stamp_ns)
        if in_site is None:
            self._notes.add_note(NO_POSE)
        return in_site

    def _in_site(self, boxes: TruthBoxes3D, stamp_ns: int) -> TruthBoxes3D | None:
        """Objects in the site frame as it was at `stamp_ns`; None if the motion of the site is not known then.

        What the zones do not let be reported is ignored.
        """
        T_site_truth = self._poses.T_site_frame(boxes.frame_id, stamp_ns)
        if T_site_truth is None:
            return None
        in_site = replace(boxes_in_site(boxes, T_site_truth), stamp_ns=stamp_ns)
        is_ignored = in_site.is_ignored | ~is_reported(in_site.centers, self._result.rig.zones)
        return replace(in_site, is_ignored=is_ignored)

    def in_image(self, name: str, stamp_ns: int, frame: int) -> TruthBoxes2D | None:
        """True boxes of a frame's image: those that the truth has, else its objects at the image's time, projected."""
        if self._truth is None:
            return None
        of_truth_ns = stamp_ns + self._offset_ns
        shown = self._truth.in_image(name, of_truth_ns, frame=frame)
        if shown is not None:
            return shown
        moment = self._truth.moment(of_truth_ns, frame=frame)
        if moment is None or (in_site := self._in_site(moment.boxes, stamp_ns)) is None:
            return None
        return projected_truth(in_site, self._cameras[name], moment.camera_pixels.get(name))
