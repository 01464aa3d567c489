"""The trackers of a run: frames in, their objects out, with tracks and the cameras that confirm them."""

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from lidcam.pipeline.core.arrays import I64
from lidcam.pipeline.core.detections import Fused
from lidcam.pipeline.core.frame import FrameResult
from lidcam.pipeline.core.rig import Rig, Zone
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.core.tracks import NO_TRACK
from lidcam.pipeline.fusion.belief.memory import MAX_AGE_S
from lidcam.pipeline.tracking.fixed_frame import SightingsOf, with_tracks
from lidcam.pipeline.tracking.motion import Priors
from lidcam.pipeline.tracking.offline import OfflineTracker
from lidcam.pipeline.tracking.online import OnlineTracker
from lidcam.pipeline.tracking.sightings import FrameSightings, TrackRows


class Confirmations:
    """The last votes of each camera, by track; they expire after `MAX_AGE_S`, as its evidence does.

    A camera that is slower than the frames is missing in most of them, which withdraws nothing.
    """

    def __init__(self) -> None:
        self._votes: dict[str, tuple[int, I64]] = {}

    def confirm(self, fused: Fused, stamp_ns: int, matched_rows: Mapping[str, I64]) -> Fused:
        """The objects of the next frame with the number of cameras that confirm the track of each.

        Args:
            fused: The objects, with tracks; `matched` of those without one stays.
            stamp_ns: Stamp of the frame.
            matched_rows: Rows (M,) of the hypotheses that each camera with 2D boxes matched, by its name.
        """
        if (tracks := fused.tracks) is None:
            return fused
        self._votes |= {name: (stamp_ns, tracks.ids[np.isin(fused.rows, rows)]) for name, rows in matched_rows.items()}
        matched = np.zeros(len(tracks), np.int32)
        for since_ns, ids in self._votes.values():
            if 0 <= stamp_ns - since_ns <= MAX_AGE_S * 1e9:
                matched += np.isin(tracks.ids, ids)
        return replace(fused, matched=np.where(tracks.ids == NO_TRACK, fused.matched, matched))


class ObjectTracker:
    """Replaces the objects of frames, which come in order, by those of their tracks."""

    def __init__(
        self,
        tracker: OnlineTracker | OfflineTracker,
        sightings_of: SightingsOf,
        zones: Sequence[Zone],
        *,
        all_speeds: bool = False,
    ) -> None:
        """With `all_speeds` the speeds of tracks with too few measurements are taken as known, too."""
        self._all_speeds = all_speeds
        self._tracker, self._sightings_of, self._zones = tracker, sightings_of, zones
        self._confirmations = Confirmations()
        self._waiting: deque[tuple[Fused, FrameSightings, dict[str, I64]]] = deque()

    def add_frame(self, frame: FrameResult) -> list[Fused]:
        """Add a frame; the objects of the oldest waiting ones that are settled. Raises FrameError as `pose_of` does."""
        seen = self._sightings_of(frame)
        matched_rows = {name: frame.matches[name].pairs[:, 0] for name in frame.detections.cameras}
        self._waiting.append((frame.fused, seen, matched_rows))
        return self._settled(self._tracker.add_frame(seen))

    def finish(self) -> list[Fused]:
        """The objects of all waiting frames."""
        return self._settled(self._tracker.finish())

    def _settled(self, frames: list[TrackRows]) -> list[Fused]:
        out = []
        for rows in frames:
            fused, seen, matched_rows = self._waiting.popleft()
            tracked = with_tracks(fused, seen, rows, self._zones)
            if tracked.tracks is not None and not self._all_speeds:
                unknown = np.isin(tracked.tracks.ids, rows.ids[~rows.speeds_known])
                tracked = replace(tracked, tracks=tracked.tracks.without_motion(unknown))
            out.append(self._confirmations.confirm(tracked, seen.stamp_ns, matched_rows))
        return out


def object_tracker(config: Config, rig: Rig, *, all_speeds: bool = False) -> ObjectTracker | None:
    """The configured tracker; None without tracking. `all_speeds`: see `ObjectTracker`."""
    if config.track.mode == "none":
        return None
    make = OnlineTracker if config.track.mode == "online" else partial(OfflineTracker, window_s=config.track.window_s)
    priors = Priors.of_classes(config.classes)
    tracker = make(priors, min_existence=config.fuse.min_score, max_gap_s=config.track.max_gap_s)
    sightings_of = SightingsOf(rig, len(config.classes), lidars_show_front=config.detect3d.engine != "cluster")
    return ObjectTracker(tracker, sightings_of, rig.zones, all_speeds=all_speeds)
