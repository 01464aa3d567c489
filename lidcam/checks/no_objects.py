"""Tells of runs without a single object what each step left in the frame that came closest to one."""

from collections.abc import Iterator

from lidcam.pipeline.core.frame import FrameResult
from lidcam.pipeline.core.rig import Rig
from lidcam.pipeline.core.settings.config import Config
from lidcam.readers.recording import Recording
from lidcam.run.choice import UsedSettings
from lidcam.run.scene import MODEL_EXTENT_M, judge, measure_scene, scene_text
from lidcam.run.warning import RunWarning

MAX_EXTENT_M = 2000.0
"""Maximum width of clouds in metres: no lidar sees further."""

MODEL_CARS = "sandbox finds model cars alone: try --config road for people and full-size vehicles; else "

REMEDY = "look for the first step that leaves nothing, and for the setting beside it"


class ObjectCheck:
    """Keeps the frame that came closest to an object while there is none, and examines it at the end of the run."""

    def __init__(self, recording: Recording, rig: Rig, config: Config, settings: UsedSettings, *, moves: bool) -> None:
        """Prepare for a run with these settings; `moves`: the site frame is known to move."""
        self._recording, self._rig, self._config = recording, rig, config
        self._settings, self._moves = settings, moves
        self._closest: FrameResult | None = None
        self._best: tuple[float, ...] = ()
        self._any = False

    def add_frame(self, frame: FrameResult) -> None:
        """Add one frame."""
        self._any = self._any or len(frame.fused.objects) > 0
        if self._any:
            self._closest = None
            return
        left_out, unused = sum(frame.fused.left_out.values()), sum(frame.unused_boxes3d.values())
        most_probable, left = float(frame.beliefs.max(initial=0)), frame.combined.counts["left"]
        rank = left_out, most_probable, unused, self._heard(frame), left
        if rank > self._best:
            self._closest, self._best = frame, rank

    @property
    def warnings(self) -> Iterator[RunWarning]:
        """One if there were frames, and no object in any."""
        if self._closest is not None:
            finding = f"frame {self._closest.bundle.index} came closest: {', '.join(self._steps(self._closest))}"
            yield RunWarning("no objects", finding, self._remedy())

    def _heard(self, frame: FrameResult) -> int:
        """Number of messages of recorded 3D boxes."""
        return sum(detector.topic in frame.bundle.messages for detector in self._rig.detectors)

    def _steps(self, frame: FrameResult) -> list[str]:
        """Lines on what each step kept and left out."""
        config, counts, boxes = self._config, frame.combined.counts, frame.hypotheses.boxes
        steps = [
            f"{counts['input'] - counts['nan']} points",
            f"{counts['range']} of them outside of combine.min_range_m and max_range_m",
            f"{counts['ground']} of the ground (combine.ground)",
            f"{len(boxes)} boxes of at least detect3d.min_score {config.detect3d.min_score:g}",
        ]
        if self._rig.detectors:
            steps.append(f"{self._heard(frame)} messages of recorded 3D boxes")
        if len(boxes):
            steps.append(f"the most probable {frame.beliefs.max():.2f}, of fuse.min_score {config.fuse.min_score:g}")
        left_out = (*frame.unused_boxes3d.items(), *frame.fused.left_out.items())
        return [*steps, *(f"{count} {reason}" for reason, count in left_out)]

    def _remedy(self) -> str:
        """Other settings, if those in use are not what the recording calls for."""
        size = self._settings.size or measure_scene(self._recording, self._rig, self._config)
        if size is None:
            return REMEDY
        if size.extent_m[0] > MAX_EXTENT_M:
            extent = " x ".join(f"{value:.0f}" for value in size.extent_m)
            return f"clouds of {extent} m are probably in millimetres: record them in metres (REP 103)"
        preset = judge(size, moves=self._moves)
        if size.lidar_height_m is None:  # the extent alone says little
            preset = "sandbox" if size.extent_m[0] < MODEL_EXTENT_M else self._settings.name
        if preset == self._settings.name:
            return f"{MODEL_CARS if preset == 'sandbox' else ''}{REMEDY}"
        condition = " if this is a model site" if preset == "sandbox" else ""  # not a room
        return f"{scene_text(size, moves=self._moves)}: try --config {preset}{condition}; else {REMEDY}"
