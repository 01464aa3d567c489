"""Messages of `/tracks`, by definitions written here by hand: a judge of the layout beside lidcam's own definitions."""

from collections.abc import Sequence
from typing import Any

import builders
import numpy as np
from message_layouts import message_of_layout

from lidcam.pipeline.core.messages import RawMessage

TRACK_ARRAY = "lidcam_msgs/msg/TrackArray"
DEFINITIONS = {
    "lidcam_msgs/msg/Track": """
int64 id
string class_id
float64 existence
builtin_interfaces/Duration age
string source
bool front_known
geometry_msgs/PoseWithCovariance pose
geometry_msgs/TwistWithCovariance twist
geometry_msgs/Vector3 size
""",
    TRACK_ARRAY: """
std_msgs/Header header
lidcam_msgs/Track[] tracks
""",
}


def track(
    id_: int,
    velocity: tuple[float, float] = (0.0, 0.0),
    yaw_rate: float = 0.0,
    *,
    source: str = "both",
    deviations: tuple[float, float, float] = (0.5, 0.25, 0.125),
    **fields: Any,
) -> dict[str, Any]:
    """A track; `deviations` are those of the velocity along x and y, and of the yaw rate."""
    covariance = np.full((6, 6), 99.0)  # none of what is not read is zero
    rows = np.array([0, 1, 5])
    covariance[rows[:, None], rows] = np.diag(np.square(deviations))
    motion = {"linear": {"x": velocity[0], "y": velocity[1], "z": 7.0}, "angular": {"x": 8.0, "y": 9.0, "z": yaw_rate}}
    known = {"id": id_, "class_id": "car", "existence": 0.75, "source": source}
    return {**known, "twist": {"twist": motion, "covariance": covariance.ravel()}, **fields}


def track_array(tracks: Sequence[dict[str, Any]], *, stamp_ns: int) -> RawMessage:
    """The message of some tracks, in the frame `site`."""
    body = {"header": builders.header(stamp_ns, "site"), "tracks": list(tracks)}
    return message_of_layout(TRACK_ARRAY, DEFINITIONS, "cdr", body, topic="/tracks", stamp_ns=stamp_ns)
