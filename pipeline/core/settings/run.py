"""Settings of the output and of the run."""

from typing import Literal

from lidcam.pipeline.core.settings.model import Count, SettingsModel


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
        window: Largest number of frames in work at once; null is two per process and one more.
    """

    workers: Count | None = None
    window: Count | None = None
