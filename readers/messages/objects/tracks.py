"""Decodes lidcam_msgs/TrackArray: what lidcam's tracks say of the motion of its objects."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from lidcam.pipeline.core.arrays import Bools, CheckedTable
from lidcam.pipeline.core.messages import RawMessage
from lidcam.pipeline.core.settings.recording import DEFAULT_LIMITS, RecordingLimits
from lidcam.pipeline.core.tracks import NO_TRACK, Tracks
from lidcam.readers.messages.boundary.decoding import decoder
from lidcam.readers.messages.deserialize import deserialize_as
from lidcam.readers.messages.objects.found import check_boxes
from lidcam.readers.messages.tf import clean_frame

TRACKS = "lidcam_msgs/msg/TrackArray"

PREDICTED = "predicted"
"""The source of a track of which nothing was seen in the frame."""

MAX_NUMBER = 1e15
"""Numbers beyond this overflow when they are squared; the bound of boxes, too."""

_X_Y_YAW_RATE = np.array([0, 1, 5])
"""Rows of the 6 x 6 covariance of a twist."""


@dataclass(frozen=True, slots=True, eq=False)
class FoundTracks(CheckedTable):
    """The tracks of one message, in recorded order."""

    stamp_ns: int  # Stamp of the message
    frame_id: str  # Frame along whose axes velocities are given
    tracks: Tracks  # N tracks, each number once
    is_predicted: Bools  # (N,) bool, whether nothing of the object was seen in the frame
    unused: Mapping[str, int]  # Number of other tracks by reason, sorted by reason


@decoder
def decode_tracks(message: RawMessage, *, limits: RecordingLimits = DEFAULT_LIMITS) -> FoundTracks:
    """The tracks of a message; of several with one number, the first.

    Raises:
        MessageError: not a TrackArray, or more tracks than `limits` allow.
    """
    array = deserialize_as(message, TRACKS, limits=limits)
    n = check_boxes(array.tracks, message.topic, limits)
    ids = np.array([one.id for one in array.tracks], np.int64)
    motions = [one.twist.twist for one in array.tracks]
    numbers = np.array(
        [
            (motion.linear.x, motion.linear.y, motion.angular.z, one.existence, _age_s(one.age))
            for one, motion in zip(array.tracks, motions, strict=True)
        ],
        np.float64,
    ).reshape(n, 5)
    covariances = np.array([one.twist.covariance for one in array.tracks], np.float64).reshape(n, 6, 6)
    covariances = covariances[:, _X_Y_YAW_RATE[:, None], _X_Y_YAW_RATE]
    is_numbered = ids > NO_TRACK
    is_first = np.zeros(n, np.bool_)
    is_first[np.unique(ids, return_index=True)[1]] = True
    is_sound = (np.abs(numbers) <= MAX_NUMBER).all(1) & (np.abs(covariances) <= MAX_NUMBER).all((1, 2))
    unused = Counter[str]()
    unused["track without a number"] = int((~is_numbered).sum())
    unused["track whose number another one has"] = int((is_numbered & ~is_first).sum())
    unused["track whose motion is not finite"] = int((is_numbered & is_first & ~is_sound).sum())
    kept = np.flatnonzero(is_numbered & is_first & is_sound)
    return FoundTracks(
        message.stamp_ns,
        clean_frame(array.header.frame_id),
        Tracks(
            ids[kept],
            numbers[kept, :2],
            covariances[kept, :2, :2],
            numbers[kept, 2],
            covariances[kept, 2, 2],
            np.clip(numbers[kept, 3], 0, 1),
            numbers[kept, 4],
            np.array([bool(array.tracks[row].front_known) for row in kept.tolist()], np.bool_),
        ),
        np.array([array.tracks[row].source == PREDICTED for row in kept.tolist()], np.bool_),
        {reason: count for reason, count in sorted(unused.items()) if count},
    )


def _age_s(age: Any) -> float:
    return float(age.sec + age.nanosec / 1e9)
