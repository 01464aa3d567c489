"""Settings of what is written, and of how the work is done."""

from typing import Literal

from pipeline.core.settings.model import Count, SettingsModel

__all__ = ["OutputConfig", "RunConfig"]


class OutputConfig(SettingsModel):
    """What is written.

    Attributes:
        images: Whether images are copied to the output.
        clouds: Whether the combined cloud is written.
        compression: Of the MCAP's chunks.
    """

    images: bool = True
    clouds: bool = True
    compression: Literal["none", "lz4", "zstd"] = "lz4"


class RunConfig(SettingsModel):
    """How the work is done; none of it changes the result.

    Attributes:
        workers: 1 runs stage after stage; with more, stages run on threads of their own, and more frames overlap.
        window: Frames in work at once; None: two more than workers.
    """

    workers: Count = 2
    window: Count | None = None
