"""The images of frames in a Rerun recording, with the boxes on them."""

from collections.abc import Callable
from typing import Any

import cv2
import rerun as rr

from lidcam.pipeline.core.errors import MessageError
from lidcam.pipeline.core.frame import Missing
from lidcam.pipeline.core.messages import Drop, RawMessage
from lidcam.pipeline.core.optics.images import Image
from lidcam.pipeline.core.rig import CameraSensor
from lidcam.pipeline.core.settings.config import Config
from lidcam.writers.drawing import DrawnObjects, ObjectEdges, camera_image, drawn_boxes_2d
from lidcam.writers.messages.sensors import COMPRESSED, read_image
from lidcam.writers.rerun import archetypes
from lidcam.writers.rerun.blueprint import camera_path
from lidcam.writers.rerun.objects import News

JPEG_QUALITY = 90
_MAGIC = {b"\xff\xd8\xff": "image/jpeg", b"\x89PN": "image/png"}


class CameraLog:
    """Logs the images of one run's frames.

    Args:
        decode_any_image: Decodes an image that is neither JPEG nor PNG; those are passed through.

    Attributes:
        waiting_bytes: Bytes of images that were logged; the caller takes them off when they are in the file.
    """

    def __init__(
        self, recording: rr.RecordingStream, config: Config, decode_any_image: Callable[[RawMessage], Image]
    ) -> None:
        self._recording, self._config, self._decode = recording, config, decode_any_image
        self._news = News()
        self._shown: set[str] = set()
        self.waiting_bytes = 0

    def log(self, camera: CameraSensor, objects: DrawnObjects, edges: ObjectEdges) -> tuple[Drop, ...]:
        """Log an image and what is drawn on it; a camera slower than the frames keeps its last image.

        Returns:
            Images that cannot be decoded.
        """
        result = objects.result
        message = camera_image(result, camera)
        is_slower = result.bundle.missing.get(camera.topic) == Missing.NOT_NEAR
        if message is None and camera.name not in result.detections.cameras:
            if not is_slower:
                self._clear(camera)
            return ()
        self._shown.add(camera.name)
        image: Any = rr.Clear(recursive=False)
        drops: tuple[Drop, ...] = ()
        if message is not None and self._config.output.images:
            try:
                image = self._encoded(message)
            except MessageError as err:
                drops = (Drop(message.topic, message.stamp_ns, "the image cannot be shown", str(err)),)
        drawn = drawn_boxes_2d(objects, camera.name)
        if not is_slower:
            self._log("image", camera, image)
        path = camera_path(camera)
        if self._news.at(f"{path}/boxes", len(drawn.labels)):
            self._log("boxes", camera, archetypes.boxes_2d(drawn))
            self._log("boxes/labels", camera, archetypes.labels_2d(drawn, camera))
        if self._news.at(f"{path}/objects", len(edges[1])):
            self._log("objects", camera, archetypes.edges_2d(objects, edges))
        return drops

    def _clear(self, camera: CameraSensor) -> None:
        if camera.name in self._shown:
            self._shown.remove(camera.name)
            for leaf in ("boxes", "objects"):
                self._news.cleared(f"{camera_path(camera)}/{leaf}")
            for leaf in ("image", "boxes", "boxes/labels", "objects"):
                self._log(leaf, camera, rr.Clear(recursive=False))

    def _encoded(self, message: RawMessage) -> rr.EncodedImage:
        """The image as JPEG or PNG.

        Raises:
            MessageError: the bytes are not an image.
        """
        if message.channel.msgtype == COMPRESSED:
            data = read_image(message).data.tobytes()
            if (media_type := _MAGIC.get(data[:3])) is not None:
                self.waiting_bytes += len(data)
                return rr.EncodedImage(contents=data, media_type=media_type)
        rgb = self._decode(message).rgb
        done, jpeg = cv2.imencode(
            ".jpg", cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY]
        )
        if not done:
            raise MessageError(f"{message.topic}: an image of {rgb.shape[1]} x {rgb.shape[0]} px cannot become a JPEG")
        self.waiting_bytes += jpeg.nbytes
        return rr.EncodedImage(contents=jpeg.tobytes(), media_type="image/jpeg")

    def _log(self, leaf: str, camera: CameraSensor, entity: Any) -> None:
        self._recording.log(f"{camera_path(camera)}/{leaf}", entity)
