"""Decodes nav_msgs/Odometry."""

from lidcam.pipeline.core.errors import FrameError, MessageError
from lidcam.pipeline.core.geometry.transform import Transform
from lidcam.pipeline.core.messages import RawMessage
from lidcam.pipeline.core.settings.recording import DEFAULT_LIMITS, RecordingLimits
from lidcam.readers.messages.boundary.decoding import decoder
from lidcam.readers.messages.deserialize import deserialize_as
from lidcam.readers.messages.tf import clean_frame

ODOMETRY = "nav_msgs/msg/Odometry"


@decoder
def decode_odometry(message: RawMessage, *, limits: RecordingLimits = DEFAULT_LIMITS) -> Transform:
    """The pose of the child frame, which is empty if the publisher does not name it, in the frame that it moves in.

    Raises:
        MessageError: not an Odometry, the frames are missing or equal, or the pose is invalid.
    """
    odometry = deserialize_as(message, ODOMETRY, limits=limits)
    parent, child = clean_frame(odometry.header.frame_id), clean_frame(odometry.child_frame_id)
    if not parent or parent == child:
        raise MessageError(f"{message.topic}: expected two frame names, found frame_id {parent!r}, child {child!r}")
    position, orientation = odometry.pose.pose.position, odometry.pose.pose.orientation
    try:
        return Transform.from_quaternion(
            parent,
            child,
            [position.x, position.y, position.z],
            [orientation.x, orientation.y, orientation.z, orientation.w],
        )
    except FrameError as err:
        raise MessageError(f"{message.topic}: {err}") from err
