"""A result as labelled images, as recorded: for detectors of images."""

from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import replace

import cv2
import numpy as np

from lidcam.outputs.export.frames import FUSED, ExportOptions, ResultFrames
from lidcam.pipeline.core.errors import OutputError
from lidcam.pipeline.core.geometry.transform import Transform
from lidcam.pipeline.core.messages import RawMessage
from lidcam.pipeline.core.rig import CameraSensor
from lidcam.pipeline.evaluation.evaluation_frame import UNKNOWN, EvaluationFrame
from lidcam.pipeline.fusion.shown import Origin, shown_boxes
from lidcam.readers.messages.image import image_file
from lidcam.readers.results.result import Result
from lidcam.writers.datasets.images import VAL_SHARE, ImageLabels, ImageWriter, LabelledFrame, LabelledImage

ORIGINS = np.array([origin.name.lower() for origin in Origin])


class ResultImages(ResultFrames):
    """A result, image by image.

    Raises:
        OutputError: there are no images, or none of the camera that is wanted.
        LidcamError: the truth cannot be read.
    """

    def __init__(self, result: Result, writer: ImageWriter, options: ExportOptions, stack: ExitStack) -> None:
        super().__init__(result, options, writer.left_out, stack)
        known = [camera.name for camera in self.images.values()]
        if not known:
            raise OutputError(
                f"{result.path}: expected images, found none: process the recording with cameras and output.images=true"
            )
        if options.camera and options.camera not in known:
            raise OutputError(
                f"{result.path}: expected a camera with images, {', '.join(known)}, found {options.camera}"
            )
        self.images = {topic: one for topic, one in self.images.items() if options.camera in ("", one.name)}
        self._frame_count = next(one.message_count for one in result.recording.topics if one.topic == FUSED)
        self._class_names = np.array(result.config.class_names)

    @property
    def facts(self) -> tuple[str, ...]:
        """The names of the classes."""
        return self._result.config.class_names

    def frames(self) -> Iterator[LabelledFrame]:
        """Every Nth frame."""
        for found, messages in self.frames_and_messages([*self.images]):
            shown = [(messages[topic], camera) for topic, camera in self.images.items() if topic in messages]
            images = (self._image(found, message, camera) for message, camera in shown)
            yield LabelledFrame(found.stamp_ns, tuple(image for image in images if image is not None))

    def _image(self, frame: EvaluationFrame, message: RawMessage, camera: CameraSensor) -> LabelledImage | None:
        rgb = self.pixels_of(message, camera)
        if rgb is None:
            return None
        height, width = rgb.shape[:2]
        if (width, height) != (camera.model.width_px, camera.model.height_px):
            self._left_out[f"images of {camera.name} that have another size than its calibration"] += 1
            return None
        truth = self._truth_of(frame, message.stamp_ns, camera)
        if self._truth.source is not None and truth is None:
            self._left_out[f"images of {camera.name} without truth at their time"] += 1
            return None
        recorded = image_file(message, limits=self._result.config.limits)
        data, ending = recorded or (cv2.imencode(".png", rgb[..., ::-1])[1].tobytes(), ".png")
        return LabelledImage(
            name=f"{self._result.path.stem}__{camera.name}__{frame.index:06d}",
            camera=camera.name,
            frame=frame.index,
            stamp_ns=message.stamp_ns,
            data=data,
            ending=ending,
            width_px=width,
            height_px=height,
            found=self._shown(frame, message.stamp_ns, camera),
            truth=truth,
            is_late=frame.index >= (1 - VAL_SHARE) * self._frame_count,
        )

    def _shown(self, frame: EvaluationFrame, stamp_ns: int, camera: CameraSensor) -> ImageLabels:
        """The labels of an image: objects where they are at its time, from where the camera stood then."""
        source, images = frame.sources["fused"], frame.images.get(camera.name)
        objects, is_predicted = source.boxes, np.zeros(len(source), np.bool_)
        if source.motion is not None:
            moved = np.nan_to_num(source.motion.velocities) * ((stamp_ns - frame.stamp_ns) * 1e-9)
            objects = replace(objects, centers=objects.centers + np.pad(moved, ((0, 0), (0, 1))))
            is_predicted = source.motion.is_predicted
        then = self._poses.T_fixed_site(stamp_ns)
        if then is not None and frame.T_fixed_site is not None:
            site = self._result.rig.site_frame
            since = Transform(site, site, np.linalg.inv(then.matrix) @ frame.T_fixed_site)
            camera = replace(camera, T_camera_site=camera.T_camera_site @ since)
        shown = shown_boxes(objects, source.track_ids, is_predicted, camera, images.found if images else None)
        if self._options.confirmed:
            shown = shown.select(shown.origins == Origin.BOTH)
        names = self._class_names[shown.class_ids]
        return ImageLabels(names, shown.xyxy, shown.scores, shown.track_ids, ORIGINS[shown.origins])

    def _truth_of(self, frame: EvaluationFrame, stamp_ns: int, camera: CameraSensor) -> ImageLabels | None:
        images = frame.images.get(camera.name)
        truth = images.truth if images else self._evaluated.in_image(camera.name, stamp_ns, frame.index)
        if truth is None:
            return None
        is_none, is_ignored = truth.class_ids == UNKNOWN, truth.is_ignored
        self.count("true boxes of no class of the settings", is_none & ~is_ignored)
        self.count("true boxes that are marked as ignored", is_ignored)
        truth = truth.select(~is_none & ~is_ignored)
        size = np.array([camera.model.width_px, camera.model.height_px] * 2, np.float32)
        n, names = len(truth), self._class_names[truth.class_ids]
        xyxy = np.clip(truth.xyxy, 0, size)
        return ImageLabels(names, xyxy, np.ones(n, np.float32), truth.track_ids, np.full(n, "truth"))
