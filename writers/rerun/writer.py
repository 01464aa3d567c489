"""Writes FrameResults to a Rerun recording: cloud, images, 2D and 3D boxes, transforms, and a layout.

`world` is the site frame. A frame is logged at its stamp (timeline `stamp`) and index (`frame`). Rerun's global
recording is not used. Equal results give equal data, but not equal bytes (Rerun's row ids come from the clock): compare
with `rerun rrd compare`.
"""

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import cv2
import numpy as np
import rerun as rr

from pipeline.core.arrays import F32, U8, Array
from pipeline.core.clouds import CombinedCloud
from pipeline.core.detections import Boxes2D, Boxes3D, Matches
from pipeline.core.errors import MessageError
from pipeline.core.frame import FrameResult, Missing
from pipeline.core.images import Image
from pipeline.core.messages import Drop, RawMessage
from pipeline.core.rig import CameraSensor, Rig
from pipeline.core.settings.config import Config
from writers.atomic import atomic_output, output_errors
from writers.messages.images import COMPRESSED, read_image
from writers.messages.scene import object_labels
from writers.palette import CAMERA_ONLY, LIDAR_ONLY, MATCHED, class_color
from writers.provenance import Provenance
from writers.rerun.blueprint import SceneScale, blueprint, camera_path

__all__ = ["RerunResultWriter"]

MAX_POINTS = 100_000
"""Points logged per frame; larger clouds are thinned evenly to keep the viewer responsive."""

JPEG_QUALITY = 90
_GROUND_GREY = (70, 76, 86)
# Low to high; muted, so that the boxes stand out from the cloud.
_HEIGHT_STOPS = np.array([[62, 84, 128], [108, 150, 190], [176, 205, 218], [245, 240, 225]], np.float64)
_MAGIC = {b"\xff\xd8\xff": "image/jpeg", b"\x89PN": "image/png"}


class RerunResultWriter:
    """Writes one run's frames to `path`, which appears when the block ends without error.

    Args:
        path: The file to write; an older one is replaced.
        rig: The rig of the run.
        config: The settings of the run; `output` selects images and clouds.
        provenance: Gives the recording id: equal for equal inputs and settings.
        decode_any_image: Decodes an image that is neither JPEG nor PNG; those are passed through.
    """

    name = "rerun"

    def __init__(
        self,
        path: Path,
        rig: Rig,
        config: Config,
        provenance: Provenance,
        *,
        decode_any_image: Callable[[RawMessage], Image],
    ) -> None:
        self._path, self._rig, self._config = path, rig, config
        self._provenance, self._decode = provenance, decode_any_image
        self._resources = ExitStack()
        self._recording: rr.RecordingStream
        self._scale: SceneScale | None = None

    def __enter__(self) -> Self:
        with ExitStack() as resources, output_errors(self._path):
            part = resources.enter_context(atomic_output(self._path))
            self._recording = rr.RecordingStream(
                "lidcam", recording_id=self._provenance.recording_id, send_properties=False
            )
            self._recording.set_log_time_enabled(False)
            self._recording.set_log_tick_enabled(False)
            self._recording.save(part)
            resources.callback(self._recording.disconnect)
            self._recording.send_recording_name(
                ", ".join(known["name"] for known in self._provenance.inputs) or "lidcam"
            )
            self._resources = resources.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with output_errors(self._path):
            self._resources.__exit__(kind, error, trace)

    def write(self, result: FrameResult) -> tuple[Drop, ...]:
        """Log one frame.

        Returns:
            Images that cannot be decoded.
        """
        if self._scale is None:
            self._scale = SceneScale.of(result.combined, self._rig)
            self._log_rig(self._scale)
            self._recording.send_blueprint(blueprint(self._rig, self._scale))
        self._recording.set_time("frame", sequence=result.bundle.index)
        self._recording.set_time("stamp", timestamp=np.datetime64(result.bundle.stamp_ns, "ns"))
        if self._config.output.clouds:
            self._log_cloud(result.combined, self._scale)
        self._log_objects(result.fused.objects, object_labels(result, self._config.class_names))
        drops: list[Drop] = []
        for camera in self._rig.cameras:
            boxes, matches = result.detections.cameras.get(camera.name), result.matches.get(camera.name)
            is_slower = result.bundle.missing.get(camera.topic) == Missing.NOT_NEAR
            if is_slower and boxes is None:  # its last image stays, with the boxes that belong to it
                continue
            if not is_slower:
                drops += self._log_image(camera, result)
            self._log("boxes", camera, _boxes_2d(boxes, matches, self._config.class_names))
            self._log("projected", camera, _projected(matches))
        self._recording.log("metrics/objects", rr.Scalars(float(len(result.fused.objects))))
        self._recording.log("metrics/confirmed", rr.Scalars(float((result.fused.matched > 0).sum())))
        self._recording.log("metrics/skew_ms", rr.Scalars(result.bundle.skew_ns / 1e6))
        return tuple(drops)

    def _log(self, leaf: str, camera: CameraSensor, entity: Any) -> None:
        self._recording.log(f"{camera_path(camera)}/{leaf}", entity)

    def _log_rig(self, scale: SceneScale) -> None:
        static = self._recording
        names = self._config.class_names
        context = [
            rr.AnnotationInfo(id=class_id, label=name, color=class_color(class_id).bytes_rgb)
            for class_id, name in enumerate(names)
        ]
        static.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, rr.AnnotationContext(context), static=True)
        for lidar in self._rig.lidars:
            pose = lidar.T_site_lidar
            static.log(
                f"world/lidars/{lidar.name}",
                rr.Transform3D(translation=pose.translation, quaternion=rr.Quaternion(xyzw=pose.quaternion_xyzw)),
                rr.TransformAxes3D(scale.radius_m * 0.04),
                static=True,
            )
        for camera in self._rig.cameras:
            pose, model = camera.T_camera_site.inverse(), camera.model
            static.log(
                camera_path(camera),
                rr.Transform3D(translation=pose.translation, quaternion=rr.Quaternion(xyzw=pose.quaternion_xyzw)),
                rr.Pinhole(
                    image_from_camera=model.K,
                    width=model.width_px,
                    height=model.height_px,
                    camera_xyz=rr.ViewCoordinates.RDF,
                    image_plane_distance=scale.radius_m * 0.08,
                ),
                static=True,
            )
        for path, color, label in (
            ("objects", class_color(0), "objects"),
            ("confirmed", MATCHED, "confirmed by cameras"),
            ("skew_ms", CAMERA_ONLY, "sync skew (ms)"),
        ):
            static.log(f"metrics/{path}", rr.SeriesLines(colors=color.bytes_rgb, names=label), static=True)

    def _log_cloud(self, combined: CombinedCloud, scale: SceneScale) -> None:
        total = len(combined.cloud) + len(combined.ground_cloud)
        share = min(1.0, MAX_POINTS / total) if total else 1.0
        xyz, ground = _thinned(combined.cloud.xyz, share), _thinned(combined.ground_cloud.xyz, share)
        height = (xyz[:, 2] - scale.low_m) / (scale.high_m - scale.low_m)
        size = rr.Radius.ui_points(1.3)
        self._recording.log("world/cloud", rr.Points3D(xyz, colors=_height_colors(height), radii=size))
        self._recording.log("world/ground", rr.Points3D(ground, colors=_GROUND_GREY, radii=rr.Radius.ui_points(0.9)))

    def _log_objects(self, objects: Boxes3D, labels: Sequence[str]) -> None:
        half = objects.yaws / 2
        zeros = np.zeros_like(half)
        quaternions = np.stack([zeros, zeros, np.sin(half), np.cos(half)], -1)
        ahead = np.stack([np.cos(objects.yaws), np.sin(objects.yaws), zeros], -1)
        self._recording.log(
            "world/objects",
            rr.Boxes3D(
                centers=objects.centers,
                sizes=objects.sizes,
                quaternions=quaternions,
                class_ids=objects.class_ids,
                labels=labels,
                show_labels=True,
                fill_mode="TransparentFillMajorWireframe",
                radii=rr.Radius.ui_points(1.5),
            ),
        )
        colors = [class_color(class_id).bytes_rgb for class_id in objects.class_ids.tolist()]
        self._recording.log(
            "world/objects/heading",
            rr.Arrows3D(
                origins=objects.centers,
                vectors=ahead * objects.sizes[:, :1] * 0.75,
                colors=colors,
                radii=objects.sizes[:, 2] * 0.03,
            ),
        )

    def _log_image(self, camera: CameraSensor, result: FrameResult) -> tuple[Drop, ...]:
        message = result.bundle.messages.get(camera.topic)
        unusable = {(drop.topic, drop.stamp_ns) for drop in result.drops}
        drops: tuple[Drop, ...] = ()
        if message is not None and self._config.output.images and (message.topic, message.stamp_ns) not in unusable:
            try:
                self._log("image", camera, self._encoded(message))
            except MessageError as err:
                drops = (Drop(message.topic, message.stamp_ns, "the image cannot be shown", str(err)),)
            else:
                return ()
        self._log("image", camera, rr.Clear(recursive=False))  # else an earlier image would remain
        return drops

    def _encoded(self, message: RawMessage) -> rr.EncodedImage:
        """The image as JPEG or PNG.

        Raises:
            MessageError: the bytes are not an image.
        """
        if message.channel.msgtype == COMPRESSED:
            data = read_image(message).data.tobytes()
            if (media_type := _MAGIC.get(data[:3])) is not None:
                return rr.EncodedImage(contents=data, media_type=media_type)
        rgb = self._decode(message).rgb
        done, jpeg = cv2.imencode(
            ".jpg", cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY]
        )
        if not done:
            raise MessageError(f"{message.topic}: an image of {rgb.shape[1]} x {rgb.shape[0]} px cannot become a JPEG")
        return rr.EncodedImage(contents=jpeg.tobytes(), media_type="image/jpeg")


def _height_colors(share: Array) -> U8:
    """(N, 3) colours of heights, given as shares of the scale from 0 (low) to 1 (high)."""
    stops = np.linspace(0, 1, len(_HEIGHT_STOPS))
    return np.stack([np.interp(share, stops, channel) for channel in _HEIGHT_STOPS.T], -1).astype(np.uint8)


def _thinned(xyz: F32, share: float) -> F32:
    """A `share` of the points, evenly spaced."""
    rows = np.linspace(0, len(xyz) - 1, int(len(xyz) * share)).astype(np.intp) if share < 1.0 else slice(None)
    return xyz[rows]


def _boxes_2d(boxes: Boxes2D | None, matches: Matches | None, class_names: Sequence[str]) -> rr.Boxes2D:
    """The camera's 2D boxes, matched ones in green."""
    if boxes is None or not len(boxes):
        return rr.Boxes2D(array=np.zeros((0, 4)), array_format=rr.Box2DFormat.XYXY)
    matched = set(matches.pairs[:, 1].tolist()) if matches is not None else set()
    columns = zip(boxes.class_ids.tolist(), boxes.scores.tolist(), strict=True)
    return rr.Boxes2D(
        array=boxes.xyxy,
        array_format=rr.Box2DFormat.XYXY,
        colors=[(MATCHED if row in matched else CAMERA_ONLY).bytes_rgb for row in range(len(boxes))],
        labels=[f"{class_names[class_id]} {score:.2f}" for class_id, score in columns],
        radii=rr.Radius.ui_points(1.2),
        show_labels=True,
    )


def _projected(matches: Matches | None) -> rr.Boxes2D:
    """The 3D boxes projected to upright rectangles in this image, matched ones in green."""
    if matches is None:
        return rr.Boxes2D(array=np.zeros((0, 4)), array_format=rr.Box2DFormat.XYXY)
    rows = np.flatnonzero(np.isfinite(matches.projected_xyxy).all(1))
    matched = set(matches.pairs[:, 0].tolist())
    return rr.Boxes2D(
        array=matches.projected_xyxy[rows],
        array_format=rr.Box2DFormat.XYXY,
        colors=[(MATCHED if row in matched else LIDAR_ONLY).bytes_rgb for row in rows.tolist()],
        radii=rr.Radius.ui_points(0.8),
    )
