"""Settings of the tracks, the output and the run."""

from typing import Literal

from lidcam.pipeline.core.settings.model import Count, Positive, SettingsModel


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


class OutputConfig(SettingsModel):
    """The output file.

    Attributes:
        images: Whether to copy the images to the output.
        clouds: Whether to write the combined cloud.
        ground: Whether to write the points of the ground with it, as a topic of their own.
        layout: Whether to write a layout for Foxglove beside the MCAP.
        compression: Compression of the MCAP chunks.
        copy_topics: Topics of the recording that are copied to the output as they are, as patterns like
            `/ground_truth/*`; null: the topics of the truth, so that the result can be evaluated by itself.
    """

    images: bool = True
    clouds: bool = True
    ground: bool = True
    layout: bool = True
    compression: Literal["none", "lz4", "zstd"] = "lz4"
    copy_topics: tuple[str, ...] | None = None


class RunConfig(SettingsModel):
    """Use of the machine; does not change the result.

    Attributes:
        workers: Number of processes that share the frames, with the one that reads and writes; null is one per core.
            Others are started when the rest of the recording is worth it.
    """

    workers: Count | None = None
