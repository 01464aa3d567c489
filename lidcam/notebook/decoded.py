"""Images and clouds of a frame, decoded for notebooks."""

from lidcam.pipeline.core.arrays import U8
from lidcam.pipeline.core.clouds import PointCloud
from lidcam.pipeline.core.frame import FrameResult
from lidcam.pipeline.core.settings.config import Config
from lidcam.readers.messages.image import decode_any_image
from lidcam.readers.messages.registry import decode_as
from lidcam.readers.rig.sensor_topics import CLOUD
from lidcam.readers.velodyne.decoder import VelodyneDecoders
from lidcam.readers.velodyne.scan import SCAN


def decode_images(frame: FrameResult, config: Config | None = None) -> dict[str, U8]:
    """The images of a frame by camera name, (H, W, 3) uint8, red first; cameras without an image have no entry.

    Args:
        frame: A frame of `iter_frames` or `on_frame`.
        config: Its settings, if `limits` are not the defaults.

    Raises:
        MessageError: one cannot be decoded.
    """
    limits, messages = (config or Config()).limits, frame.bundle.messages
    found = {name: messages[camera.topic] for name, camera in frame.views.items() if camera.topic in messages}
    return {name: decode_any_image(message, limits=limits).rgb for name, message in found.items()}


def decode_clouds(frame: FrameResult, config: Config | None = None) -> dict[str, PointCloud]:
    """The clouds of a frame by topic, as measured, in the frame of each lidar.

    `frame.combined.cloud` has their points in the site frame, without outliers and ground.

    Args:
        frame: A frame of `iter_frames` or `on_frame`.
        config: Its settings, if `velodyne` or `limits` are not the defaults.

    Raises:
        MessageError: one cannot be decoded.
    """
    config = config or Config()
    packets, limits, clouds = VelodyneDecoders(config.velodyne), config.limits, dict[str, PointCloud]()
    for topic, message in frame.bundle.messages.items():
        if message.channel.msgtype == SCAN:
            clouds[topic] = packets[topic].decode(message)[0]
        elif message.channel.msgtype in CLOUD:
            clouds[topic] = decode_as("cloud", message, limits=limits)
    return clouds
