"""Settings of reading: topics, rig, Velodyne packets, and limits against hostile recordings."""

from dataclasses import dataclass, fields, replace
from typing import Any, Literal, Self

from pydantic import Field, model_serializer, model_validator

from lidcam.pipeline.core.settings.model import Corners, SettingsModel, ZoneName

VelodyneModelName = Literal[
    "auto", "VLP-16", "Puck Hi-Res", "HDL-32E", "HDL-64E S2", "HDL-64E S3", "VLP-32A", "VLP-32B", "VLP-32C", "VLS-128"
]


class TopicsConfig(SettingsModel):
    """Topics to use.

    Attributes:
        lidars: Topics with clouds; null: all of a suitable type, an empty list: none.
        cameras: Topics with images, or with 2D boxes alone; null and an empty list as for `lidars`.
        boxes3d: Topics with 3D boxes of a detector (vision_msgs/Detection3DArray or Autoware's DetectedObjects), for
            `detect3d.method: recorded`. If null: all that are neither truth nor what lidcam itself writes.
        exclude: Topics to ignore, by name or shell pattern.
    """

    lidars: tuple[str, ...] | None = None
    cameras: tuple[str, ...] | None = None
    boxes3d: tuple[str, ...] | None = None
    exclude: tuple[str, ...] = ()


class ZoneConfig(SettingsModel):
    """A part of the site; a list of corners alone is a zone of use `count`.

    Attributes:
        corners: Corners x, y in the site frame.
        use: With `count` the objects inside are counted. With `detect` they are, too, and objects outside of all zones
            of this use are not reported. With `ignore` the objects inside are not reported.
    """

    corners: Corners
    use: Literal["count", "detect", "ignore"] = "count"

    @model_validator(mode="before")
    @classmethod
    def _of_corners(cls, value: Any) -> Any:
        return {"corners": value} if isinstance(value, list | tuple) else value

    @model_serializer
    def _as_short_as_possible(self) -> Any:
        return self.corners if self.use == "count" else {"corners": self.corners, "use": self.use}


class RigConfig(SettingsModel):
    """Assumptions about the rig.

    Attributes:
        site_frame: Frame in which clouds are combined and objects reported. If empty: the one in the rig file, else
            `base_link` if the lidars are fixed to it, else the frame that all lidars are fixed to.
        zones: Parts of the site by name: corners x, y in the site frame, or `corners` and `use`. An object belongs to
            the first zone that holds its centre, those of use `ignore` apart. The zones of a rig file replace them.
    """

    site_frame: str = ""
    zones: dict[ZoneName, ZoneConfig] = Field(default_factory=dict)


class VelodyneConfig(SettingsModel):
    """Raw packets of Velodyne lidars (velodyne_msgs): what they do not say of the lidar.

    Attributes:
        model: `auto` reads it from the packets, which do not tell a VLP-32A from a VLP-32B, nor name an HDL-64E.
        calibration: YAML file of ROS's velodyne driver; if empty, the table in the manual. Required for an HDL-64E.
    """

    model: VelodyneModelName = "auto"
    calibration: str = ""


@dataclass(frozen=True, slots=True)
class RecordingLimits:
    """Limits that keep a hostile recording from filling memory or disk; valid recordings stay far below them.

    Anything beyond a limit is treated as damage. The setting `limit_scale` multiplies them all.
    """

    # Unpacked size of a compressed file, and of the chunks of a file in one reading, each as often as it is unpacked;
    # at least twenty times the size of the file is allowed
    max_unpacked_file_gib: float = 4.0
    max_chunk_bytes: int = 256 << 20  # Unpacked size of a compressed chunk
    max_message_bytes: int = 256 << 20  # Unpacked size of a message
    max_messages_per_chunk: int = 1_000_000  # Records in one chunk
    # Messages whose times are in memory at once, for the rates that `inspect` shows
    max_messages_in_memory: int = 10_000_000
    # Messages whose positions wait for their turn, some 200 bytes each: those of chunks that overlap in time, and of an
    # MCAP file those outside of chunks
    max_positions_waiting: int = 4_000_000
    max_topics: int = 1000  # Topics of one recording
    # Strings and messages in the lists of one message, as boxes or transforms; each takes kilobytes once it is decoded
    max_message_items: int = 20_000
    max_boxes: int = 2000  # Boxes in one message
    max_frames: int = 10_000  # Coordinate frames that transforms name
    max_points: int = 2_000_000  # Points in one cloud
    max_frame_points: int = 2_000_000  # Points in the clouds of one frame
    max_image_mpx: float = 50.0  # Millions of pixels in one image
    max_frame_mpx: float = 80.0  # Millions of pixels in the images of one frame that a network looks at
    # Messages that wait for those of other topics; also what the frames in work hold, roughly
    max_waiting_bytes: int = 768 << 20
    max_request_s: float = 60.0  # Time of a server for one request, however little it sends at a time
    max_losses_listed: int = 1000  # Damaged places of one file that are listed singly; the rest are summed up

    def scaled(self, factor: float) -> Self:
        """Every limit multiplied by a factor."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        return replace(self, **{name: type(value)(value * factor) for name, value in values.items()})

    def max_unpacked_bytes(self, file_bytes: int) -> int:
        """Largest unpacked size of a file of `file_bytes`, in bytes."""
        return max(round(self.max_unpacked_file_gib * 2**30), 20 * file_bytes)


DEFAULT_LIMITS = RecordingLimits()
