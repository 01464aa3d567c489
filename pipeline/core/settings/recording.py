"""Settings of what is read: topics, rig, packets of Velodynes, and how much a recording may ask for."""

from typing import Literal

from pydantic import Field

from pipeline.core.settings.model import Count, Positive, SettingsModel

__all__ = ["DEFAULT_LIMITS", "LimitsConfig", "RigConfig", "TopicsConfig", "VelodyneConfig", "VelodyneLidarConfig"]


class TopicsConfig(SettingsModel):
    """Which topics take part; empty means all that fit.

    Attributes:
        lidars: Topics of clouds.
        cameras: Topics of images.
        exclude: Topics that are not used, by name or shell pattern.
        last_resort: Topics, by name or shell pattern, that were made of others: used only where nothing else of their
            kind was recorded. Parts of combined messages go before them, and after all that was recorded by itself.
    """

    lidars: tuple[str, ...] = ()
    cameras: tuple[str, ...] = ()
    exclude: tuple[str, ...] = ()
    last_resort: tuple[str, ...] = ("/point_cloud_combined",)


class RigConfig(SettingsModel):
    """What is assumed of the rig.

    Attributes:
        site_frame: Frame that clouds are combined and objects reported in; empty: the rig file's, else `base_link` if
            the lidars are fixed to it, else the frame that they are all fixed to.
    """

    site_frame: str = ""


class VelodyneLidarConfig(SettingsModel):
    """What the packets of a Velodyne do not say of themselves.

    Attributes:
        model: `auto` takes what the packets say; VLP-32A and B are alike there, and an HDL-64E says nothing.
        calibration: YAML file of ROS's velodyne driver; empty: the manual's table. An HDL-64E needs one.
    """

    model: Literal[
        "auto",
        "VLP-16",
        "Puck Hi-Res",
        "HDL-32E",
        "HDL-64E S2",
        "HDL-64E S3",
        "VLP-32A",
        "VLP-32B",
        "VLP-32C",
        "VLS-128",
    ] = "auto"
    calibration: str = ""


class VelodyneConfig(VelodyneLidarConfig):
    """Raw packets of Velodyne lidars (velodyne_msgs): the settings for all, and for single ones.

    Attributes:
        topics: The same two settings by topic, instead of those above.
    """

    topics: dict[str, VelodyneLidarConfig] = Field(default_factory=dict)


class LimitsConfig(SettingsModel):
    """How much a recording may ask for: no sound one comes near, and a hostile one cannot fill the memory or the disk.

    What goes beyond a limit is treated as damage, and the message names the setting to raise.

    Attributes:
        max_unpacked_file_gib: What a compressed file, or all chunks of a damaged one, may unpack to; twenty times
            the size of the file where that is more.
        max_chunk_mib: What a compressed chunk may unpack to.
        max_message_mib: Largest message, unpacked.
        max_messages_per_chunk: Records in one chunk.
        max_messages_in_memory: Messages of one file whose place is held in memory at once: of chunks that overlap in
            time, and of a damaged file.
        max_topics: Topics of one recording.
        max_points: Points in one cloud.
        max_image_mpx: Millions of pixels in one image.
        max_losses_listed: Damaged places of one file that are listed one by one; the rest is added up.
    """

    max_unpacked_file_gib: Positive = 16.0
    max_chunk_mib: Count = 256
    max_message_mib: Count = 256
    max_messages_per_chunk: Count = 1_000_000
    max_messages_in_memory: Count = 10_000_000
    max_topics: Count = 1000
    max_points: Count = 10_000_000
    max_image_mpx: Positive = 100.0
    max_losses_listed: Count = 1000

    @property
    def max_chunk_bytes(self) -> int:
        """`max_chunk_mib` in bytes."""
        return self.max_chunk_mib << 20

    @property
    def max_message_bytes(self) -> int:
        """`max_message_mib` in bytes."""
        return self.max_message_mib << 20

    def max_unpacked_bytes(self, file_bytes: int) -> int:
        """What a file of `file_bytes` may unpack to, in bytes."""
        return max(round(self.max_unpacked_file_gib * 2**30), 20 * file_bytes)


DEFAULT_LIMITS = LimitsConfig()
