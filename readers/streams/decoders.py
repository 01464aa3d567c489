"""Decoders for the messages of one frame; a message that cannot be decoded is dropped or ends the run."""

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Literal, TypeVar

from lidcam.pipeline.core.clouds import PointCloud
from lidcam.pipeline.core.detections import Boxes2D
from lidcam.pipeline.core.errors import MessageError
from lidcam.pipeline.core.frame import Decoded, SensorBundle
from lidcam.pipeline.core.messages import Drop, RawMessage
from lidcam.pipeline.core.optics.images import Image
from lidcam.pipeline.core.rig import Rig
from lidcam.pipeline.core.settings.config import Config
from lidcam.readers.messages.detections import Detections2D
from lidcam.readers.messages.image import decode_any_image
from lidcam.readers.messages.objects import ObjectClasses
from lidcam.readers.messages.registry import decode_as
from lidcam.readers.velodyne.decoder import VelodyneDecoders
from lidcam.readers.velodyne.scan import PACKET_BYTES, SCAN

T = TypeVar("T")
OnBadMessage = Literal["skip", "fail"]

MAX_OTHER_SIZE = 0.02
"""Largest difference between an image's size and that of its calibration, as a share: data sets trim single images."""

POINTS_PER_PACKET = 384
"""Points of a Velodyne packet at most: twelve blocks of 32."""


class CloudDecoder:
    """Decodes the clouds of all lidars, each in its own frame."""

    def __init__(self, rig: Rig, config: Config, *, on_bad: OnBadMessage) -> None:
        self._topics = {lidar.name: lidar.topic for lidar in rig.lidars}
        self._frames = {lidar.topic: lidar.T_site_lidar.src for lidar in rig.lidars}
        self._offsets_ns = {lidar.topic: lidar.time_offset_ns for lidar in rig.lidars}
        self._velodyne = VelodyneDecoders(config.velodyne)
        self._limits = config.limits
        self._on_bad = on_bad

    def __call__(self, bundle: SensorBundle) -> Decoded[PointCloud]:
        """Clouds by lidar name; a cloud without a frame gets that of its lidar."""
        points = 0

        def decode_one(message: RawMessage) -> tuple[PointCloud, tuple[Drop, ...]]:
            nonlocal points
            cloud, drops = self._decode_one(message, points)
            points += len(cloud) + cloud.nan_dropped
            return cloud, drops

        decoded = decode_each(bundle, self._topics, decode_one, self._on_bad)
        drops = decoded.drops + tuple(drop for _, parts in decoded.values() for drop in parts)
        return Decoded({name: cloud for name, (cloud, _) in decoded.items()}, drops)

    def _decode_one(self, message: RawMessage, others: int) -> tuple[PointCloud, tuple[Drop, ...]]:
        """The cloud of a message; `others` are the points of the frame's other clouds."""
        # Times of points and packets are by the sensor's clock, so they are decoded with its own stamp.
        stamp_ns = message.stamp_ns
        message = message._replace(stamp_ns=stamp_ns + self._offsets_ns[message.topic])
        drops: tuple[Drop, ...] = ()
        if message.channel.msgtype == SCAN:
            max_points = min(self._limits.max_points, self._limits.max_frame_points - others)
            if len(message.data) // PACKET_BYTES * POINTS_PER_PACKET > max_points:
                raise MessageError(
                    f"{message.topic}: packets of {len(message.data)} bytes, expected at most {max_points} points: "
                    "raise limit_scale"
                )
            cloud, drops = self._velodyne[message.topic].decode(message)
        else:
            cloud = decode_as("cloud", message, limits=self._limits, others=others)
            drops = tuple(
                Drop(message.topic, message.stamp_ns, "packets that cannot be decoded", fault, 1)
                for fault in message.defects
            )
        return replace(cloud, stamp_ns=stamp_ns, frame_id=cloud.frame_id or self._frames[message.topic]), drops


class ImageDecoder:
    """Decodes the images of all cameras."""

    def __init__(self, rig: Rig, config: Config, *, on_bad: OnBadMessage) -> None:
        self._limits = config.limits
        self._topics = {camera.name: camera.topic for camera in rig.cameras if camera.topic}
        self._sizes_px = {one.topic: (one.model.width_px, one.model.height_px) for one in rig.cameras}
        self._on_bad = on_bad

    def __call__(self, bundle: SensorBundle) -> Decoded[Image]:
        """Images by camera name; those of another size than the calibration are dropped."""
        pixels = 0

        def decode_one(message: RawMessage) -> Image:
            nonlocal pixels
            image = decode_any_image(message, limits=self._limits, others=pixels)
            (height, width, _), size = image.rgb.shape, self._sizes_px[message.topic]
            pixels += height * width
            if any(abs(px - said) > MAX_OTHER_SIZE * said for px, said in zip((width, height), size, strict=True)):
                raise MessageError(
                    f"{message.topic}: an image of {width} x {height} px, expected {size[0]} x {size[1]} px, as of "
                    "its calibration: split the recording where the size changes"
                )
            return image

        return decode_each(bundle, self._topics, decode_one, self._on_bad)


class RecordedBoxes:
    """Decodes the 2D boxes of the recording, for all cameras that have any."""

    def __init__(self, rig: Rig, config: Config, *, on_bad: OnBadMessage) -> None:
        self._topics = {camera.name: camera.boxes_topic for camera in rig.cameras if camera.boxes_topic}
        self._min_score = config.detect2d.min_score
        self._limits = config.limits
        self._classes = ObjectClasses(config.class_id_of_label, config.detect2d.class_numbers)
        self._on_bad = on_bad

    def __call__(self, bundle: SensorBundle) -> Decoded[Boxes2D]:
        """Boxes by camera name."""
        decoded = decode_each(bundle, self._topics, self._decode_one, self._on_bad)
        unused: Counter[str] = Counter()
        boxes: dict[str, Boxes2D] = {}
        for name, found in decoded.items():
            usable = found.boxes
            unused.update(found.unused)
            sure = usable.scores >= self._min_score
            boxes[name] = usable if sure.all() else usable.select(sure)
            unused[f"score under detect2d.min_score ({self._min_score:g})"] += len(usable) - len(boxes[name])
        return Decoded(boxes, decoded.drops, dict(sorted((+unused).items())))

    def _decode_one(self, message: RawMessage) -> Detections2D:
        found: Detections2D = decode_as("2D boxes", message, self._classes, limits=self._limits)
        return found


def decode_each(
    bundle: SensorBundle, topics: Mapping[str, str], decode: Callable[[RawMessage], T], on_bad: OnBadMessage
) -> Decoded[T]:
    """Decoded messages of a frame by name; `topics` has the topic of each name."""
    found: dict[str, T] = {}
    drops: list[Drop] = []
    for name, topic in topics.items():
        message = bundle.messages.get(topic)
        if message is None:
            continue
        try:
            found[name] = decode(message)
        except MessageError as err:
            if on_bad == "fail":
                raise
            drops.append(Drop(topic, message.stamp_ns, "cannot be decoded", str(err)))
    return Decoded(found, tuple(drops))
