"""Settings of the tracks."""

from typing import Literal

from lidcam.pipeline.core.settings.model import Positive, SettingsModel


class TrackConfig(SettingsModel):
    """Tracks: which objects of different frames are one object, and how it moves.

    Attributes:
        mode: `offline` looks at the whole recording, the future of each frame too, before it says where an object is;
            frames come late by up to `window_s`. `online` says it frame by frame, as a live system could. `none`: each
            frame by itself, without numbers and speeds.
        window_s: Offline, how much of the recording is solved at once. Frames wait that long, in a file in the folder
            of the output; memory does not grow with it.
        max_gap_s: An object that is not seen for longer begins a new track.
        odometry: How tracks know how the rig moves. `auto`: from the clouds, with recorded odometry or tf as the first
            guess; where none is recorded, the clouds tell whether the rig moves at all, too. `recorded`: as recorded;
            where nothing is, it stands still.
    """

    mode: Literal["offline", "online", "none"] = "offline"
    window_s: Positive = 30.0
    max_gap_s: Positive = 3.0
    odometry: Literal["auto", "recorded"] = "auto"
