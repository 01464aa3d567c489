"""The trackers of a run: frames in, their objects out, with tracks."""

from collections import deque
from typing import Protocol

from lidcam.pipeline.core.arrays import I64
from lidcam.pipeline.core.detections import Fused
from lidcam.pipeline.core.frame import FrameResult
from lidcam.pipeline.core.rig import Rig
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.tracking.confirmed import Confirmations, matched_rows
from lidcam.pipeline.tracking.fixed_frame import SightingsOf, with_tracks
from lidcam.pipeline.tracking.motion import Priors
from lidcam.pipeline.tracking.offline import OfflineTracker
from lidcam.pipeline.tracking.online import OnlineTracker
from lidcam.pipeline.tracking.rows import TrackRows
from lidcam.pipeline.tracking.sightings import FrameSightings


class Tracker(Protocol):
    """Finds the tracks in frames that come in order."""

    def add(self, frame: FrameSightings) -> list[TrackRows]:
        """Take in a frame; the rows of the oldest frames that were not given yet, as far as they are settled."""
        ...

    def finish(self) -> list[TrackRows]:
        """The rows of all frames that were not given yet."""
        ...


class ObjectTracker:
    """Replaces the objects of frames, which come in order, by those of their tracks."""

    def __init__(self, tracker: Tracker, rig: Rig, class_count: int) -> None:
        self._tracker, self._zones = tracker, rig.zones
        self._sightings_of = SightingsOf(rig, class_count)
        self._confirmations = Confirmations()
        self._waiting: deque[tuple[Fused, FrameSightings, dict[str, I64]]] = deque()

    def add(self, frame: FrameResult) -> list[Fused]:
        """Take in a frame; the objects of the oldest frames that were not given yet, as far as they are settled.

        Raises:
            FrameError: the motion is that of a frame other than the site frame.
        """
        seen = self._sightings_of(frame)
        self._waiting.append((frame.fused, seen, matched_rows(frame)))
        return self._given(self._tracker.add(seen))

    def finish(self) -> list[Fused]:
        """The objects of all frames that were not given yet."""
        return self._given(self._tracker.finish())

    def _given(self, settled: list[TrackRows]) -> list[Fused]:
        given = []
        for rows in settled:
            fused, seen, said = self._waiting.popleft()
            tracked = with_tracks(fused, seen, rows, self._zones)
            given.append(self._confirmations.held(tracked, seen.stamp_ns, said))
        return given


def object_tracker(config: Config, rig: Rig) -> ObjectTracker | None:
    """The tracker that the settings ask for; None where nothing is to be tracked."""
    mode, priors, least = config.track.mode, Priors.of_classes(config.classes), config.fuse.min_score
    if mode == "none":
        return None
    window_s, max_gap_s = config.track.window_s, config.track.max_gap_s
    tracker: Tracker
    if mode == "online":
        tracker = OnlineTracker(priors, least_existence=least, max_gap_s=max_gap_s)
    else:
        tracker = OfflineTracker(priors, least_existence=least, window_s=window_s, max_gap_s=max_gap_s)
    return ObjectTracker(tracker, rig, len(config.classes))
