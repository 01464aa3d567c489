"""Messages of tracks, laid out by definitions that are not lidcam's."""

import math
from typing import Any

import builders
import numpy as np
import pytest
from track_messages import track, track_array

from lidcam.pipeline.core.errors import MessageError
from lidcam.pipeline.core.settings.recording import RecordingLimits
from lidcam.readers.messages.objects import decode_tracks

STAMP_NS = 1_700_000_000_123_456_789


def test_every_field_is_read_from_its_place() -> None:
    first = track(7, (3.0, -4.0), 0.5, source="predicted", age={"sec": 2, "nanosec": 500_000_000}, front_known=True)
    found = decode_tracks(track_array([first, track(1 << 40, source="camera")], stamp_ns=STAMP_NS))
    assert (found.stamp_ns, found.frame_id, len(found), dict(found.unused)) == (STAMP_NS, "site", 2, {})
    tracks = found.tracks
    np.testing.assert_array_equal(tracks.ids, [7, 1 << 40])
    np.testing.assert_array_equal(tracks.velocities, [[3, -4], [0, 0]])
    np.testing.assert_array_equal(tracks.velocity_covariances[0], np.diag([0.25, 0.0625]))
    np.testing.assert_array_equal(tracks.yaw_rates, [0.5, 0])
    np.testing.assert_array_equal(tracks.yaw_rate_variances, [1 / 64] * 2)
    np.testing.assert_array_equal(tracks.existence, [0.75, 0.75])
    np.testing.assert_array_equal(tracks.ages_s, [2.5, 0])
    np.testing.assert_array_equal(tracks.fronts_known, [True, False])
    np.testing.assert_array_equal(found.is_predicted, [True, False])


@pytest.mark.parametrize(
    ("bad", "reason"),
    [
        (track(0), "track without a number"),
        (track(5, (9.0, 9.0)), "track whose number another one has"),
        (track(6, (math.nan, 0.0)), "track whose motion is not finite"),
        (track(6, yaw_rate=math.inf), "track whose motion is not finite"),
        (track(6, deviations=(1.0, 1e100, 1.0)), "track whose motion is not finite"),
        (track(6, existence=math.nan), "track whose motion is not finite"),
    ],
)
def test_tracks_that_cannot_be_used_are_counted(bad: dict[str, Any], reason: str) -> None:
    found = decode_tracks(track_array([track(5, (1.0, 2.0)), bad, track(4)], stamp_ns=STAMP_NS))
    np.testing.assert_array_equal(found.tracks.ids, [5, 4])
    np.testing.assert_array_equal(found.tracks.velocities, [[1, 2], [0, 0]])
    assert dict(found.unused) == {reason: 1}


def test_messages_that_are_none() -> None:
    many = track_array([track(number) for number in range(1, 4)], stamp_ns=STAMP_NS)
    with pytest.raises(MessageError, match=r"/tracks: 3 boxes, expected at most 2"):
        decode_tracks(many, limits=RecordingLimits(max_boxes=2))
    with pytest.raises(MessageError, match="are not a valid lidcam_msgs/msg/TrackArray"):
        decode_tracks(many._replace(data=many.data[:-9]))
    with pytest.raises(MessageError, match="expected lidcam_msgs/msg/TrackArray, found sensor_msgs/msg/Image"):
        decode_tracks(builders.raw("/tracks", "sensor_msgs/msg/Image", {}, STAMP_NS))
