"""The objects of a frame in Rerun, in 3D and in the images of the cameras, each track at a path of its own."""

from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
import rerun as rr

from lidcam.pipeline.core.detections import source_names
from lidcam.pipeline.core.errors import MessageError
from lidcam.pipeline.core.frame import Missing
from lidcam.pipeline.core.messages import Drop, RawMessage, VideoPart
from lidcam.pipeline.core.optics.images import Image
from lidcam.pipeline.core.rig import CameraSensor, Rig
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.core.tracks import NO_TRACK, Tracks
from lidcam.writers.drawing import DrawnObjects, ObjectEdges, camera_image, drawn_boxes_2d, with_outlines
from lidcam.writers.labels_3d import LabelPlaces
from lidcam.writers.messages.sensors import COMPRESSED, read_image
from lidcam.writers.palette import CAMERA_ONLY, ZONE, class_color
from lidcam.writers.report.values import KM_H
from lidcam.writers.rerun import archetypes
from lidcam.writers.rerun.archetypes import FILL, LINE_POINTS, Look, bytes_of, turns_of
from lidcam.writers.rerun.blueprint import (
    FOV_Y_DEG,
    LABELS,
    NUMBERS,
    PLACED,
    TRACKS,
    camera_path,
    image_width_points,
    place_eye,
)
from lidcam.writers.trails import Trails
from lidcam.writers.viewpoint import SceneSurvey, drawn_zones, zone_texts


class TrackLog:
    """Logs the box of each tracked object with facts to be read, and its speed to be plotted.

    Attributes:
        classes: Class of each track, by number, as it was last.
        fastest_m_s: Highest speed of a track.
    """

    def __init__(self, recording: rr.RecordingStream) -> None:
        self._recording = recording
        self._shown: dict[int, tuple[Look, bytes]] = {}  # look and colour of those in the frame before
        self.classes: dict[int, int] = {}
        self.fastest_m_s = 0.0

    def log(self, drawn: DrawnObjects, looks: list[Look]) -> None:
        """Log the tracks of a frame, of whose objects (N,) the looks are given; those that are gone are cleared."""
        tracks = drawn.result.fused.tracks or Tracks.none(len(drawn.boxes))
        boxes, colors, turns, speeds = drawn.boxes, bytes_of(drawn.colors), turns_of(drawn.boxes.yaws), tracks.speeds
        sources = source_names(boxes.sources)
        gone, self._shown, before = set(self._shown), {}, self._shown
        for row in np.flatnonzero(drawn.tracks != NO_TRACK).tolist():
            number, class_id, speed = int(drawn.tracks[row]), int(boxes.class_ids[row]), float(speeds[row])
            path = f"{TRACKS}/{number}"
            gone.discard(number)
            if number not in self.classes:
                name, color = f"{drawn.class_names[class_id]} #{number}", class_color(class_id).bytes_rgb
                self._recording.log(path, rr.SeriesLines(colors=color, names=name), static=True)
            self.classes[number], self.fastest_m_s = class_id, max(self.fastest_m_s, speed)
            look = self._shown[number] = looks[row], colors[row].tobytes()
            if before.get(number) != look:  # the same from frame to frame
                radius, fill = rr.Radius.ui_points(LINE_POINTS[looks[row]]), FILL[looks[row]]
                self._recording.log(path, rr.Boxes3D.from_fields(colors=colors[row], radii=radius, fill_mode=fill))
            box = rr.Boxes3D.from_fields(
                centers=boxes.centers[row], half_sizes=boxes.sizes[row] / 2, quaternions=turns[row]
            )
            is_known = np.isfinite(speed)
            facts = {  # texts, as numbers would be curves in the plots
                "object": drawn.labels[row],
                "speed": f"{speed:.1f} m/s, {KM_H * speed:.0f} km/h" if is_known else "unknown",
                "source": sources[row],
                "existence": f"{tracks.existence[row]:.2f}",
                "age": f"{tracks.ages_s[row]:.1f} s",
            }
            texts = rr.DynamicArchetype(
                "lidcam.Track", components={name: rr.components.TextBatch([text]) for name, text in facts.items()}
            )
            self._recording.log(path, box, texts, rr.Scalars(speed))
        for number in sorted(gone):
            self._recording.log(f"{TRACKS}/{number}", rr.Clear(recursive=False))


JPEG_QUALITY = 90
_CODECS = {"hevc": rr.VideoCodec.H265} | {name: rr.VideoCodec[name.upper()] for name in ("h264", "vp8", "vp9", "av1")}
"""Video codecs that Rerun decodes. A stream has one."""

_MAGIC = {b"\xff\xd8\xff": "image/jpeg", b"\x89PN": "image/png"}


class CameraLog:
    """Logs the images of one run's frames.

    Args:
        decode_any_image: Decodes an image that is neither JPEG nor PNG nor of a video; those are passed through.

    Attributes:
        codecs: Of the cameras whose video is logged as it was recorded.
        waiting_bytes: Bytes of images that were logged; the caller takes them off when they are in the file.
    """

    def __init__(
        self, recording: rr.RecordingStream, rig: Rig, config: Config, decode_any_image: Callable[[RawMessage], Image]
    ) -> None:
        self._recording, self._config, self._decode = recording, config, decode_any_image
        self._width_points = image_width_points(rig)
        self._news = News()
        self._shown: set[str] = set()
        self._is_stream: dict[str, bool] = {}
        self.codecs: dict[str, str] = {}
        self.waiting_bytes = 0

    def log(self, camera: CameraSensor, objects: DrawnObjects, edges: ObjectEdges) -> tuple[Drop, ...]:
        """Log an image and what is drawn on it; a camera slower than the frames keeps its last image.

        Returns images that cannot be decoded.
        """
        result = objects.result
        message = camera_image(result, camera)
        is_slower = result.bundle.missing.get(camera.topic) == Missing.NOT_NEAR
        if message is None and camera.name not in result.detections.cameras:
            if not is_slower:
                self._clear(camera)
            return ()
        self._shown.add(camera.name)
        drops: tuple[Drop, ...] = ()
        if message is None or not self._config.output.images:
            if not is_slower:
                self._log("image", camera, rr.Clear(recursive=False))
        else:
            try:
                self._log_image(camera, message, result.bundle.video.get(camera.topic))
            except MessageError as err:
                self._log("image", camera, rr.Clear(recursive=False))
                drops = (Drop(message.topic, message.stamp_ns, "the image cannot be shown", str(err)),)
        drawn = drawn_boxes_2d(objects, camera.name)
        path = camera_path(camera)
        if self._news.at(f"{path}/boxes", len(drawn.labels)):
            self._log("boxes", camera, archetypes.boxes_2d(drawn))
        labelled = with_outlines(drawn, objects, edges)
        if self._news.at(f"{path}/labels", len(labelled.labels)):
            self._log("labels", camera, archetypes.labels_2d(labelled, camera, self._width_points))
        if self._news.at(f"{path}/objects", len(edges[1])):
            self._log("objects", camera, archetypes.edges_2d(objects, edges))
        return drops

    def _clear(self, camera: CameraSensor) -> None:
        if camera.name in self._shown:
            self._shown.remove(camera.name)
            for leaf in ("boxes", "labels", "objects"):
                self._news.add(f"{camera_path(camera)}/{leaf}")
            for leaf in ("image", "boxes", "labels", "objects"):
                self._log(leaf, camera, rr.Clear(recursive=False))

    def _log_image(self, camera: CameraSensor, message: RawMessage, video: VideoPart | None) -> None:
        """Log an image as it was recorded: as its packets, where Rerun decodes them."""
        codec = "" if video is None else self.codecs.get(camera.name, video.codec)
        is_stream = video is not None and codec in _CODECS and codec == video.codec
        if self._is_stream.setdefault(camera.name, is_stream) != is_stream:
            self._log("image", camera, rr.Clear(recursive=False))  # one would be drawn over the other
            self._is_stream[camera.name] = is_stream
        if video is None or not is_stream:
            self._log("image", camera, self._encoded(message))
            return
        self.codecs[camera.name] = codec
        for packet in video.packets:
            self._log("image", camera, rr.VideoStream(_CODECS[codec], sample=packet))
            self.waiting_bytes += len(packet)

    def _encoded(self, message: RawMessage) -> rr.EncodedImage:
        """The image as JPEG or PNG; raises MessageError if it is none."""
        if message.channel.msgtype == COMPRESSED:
            data = read_image(message).data.tobytes()
            if (media_type := _MAGIC.get(data[:3])) is not None:
                self.waiting_bytes += len(data)
                return rr.EncodedImage(contents=data, media_type=media_type)
        rgb = self._decode(message).rgb
        done, jpeg = cv2.imencode(".jpg", rgb[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
        if not done:
            raise MessageError(f"{message.topic}: an image of {rgb.shape[1]} x {rgb.shape[0]} px cannot become a JPEG")
        self.waiting_bytes += jpeg.nbytes
        return rr.EncodedImage(contents=jpeg.tobytes(), media_type="image/jpeg")

    def _log(self, leaf: str, camera: CameraSensor, entity: Any) -> None:
        self._recording.log(f"{camera_path(camera)}/{leaf}", entity)


class News(set[str]):
    """The paths at which nothing is drawn."""

    def at(self, path: str, count: int) -> bool:
        """Whether this number of things at a path is to be logged: not where there are none, and there were none."""
        if count == 0 and path in self:
            return False
        (self.discard if count else self.add)(path)
        return True


class ObjectLog:
    """Logs the objects of one run's frames, with labels and zones as the survey places them.

    Attributes:
        tracks: Logs those that have one.
    """

    def __init__(self, recording: rr.RecordingStream, rig: Rig, config: Config, survey: SceneSurvey) -> None:
        self._recording, self._rig, self._config, self._survey = recording, rig, config, survey
        self._label_places = LabelPlaces(survey, place_eye, FOV_Y_DEG)
        self._trails = Trails(rig.site_frame, config.combine.motion)
        self._news = News({"world/trails"})
        self._has_placed = False
        self.tracks = TrackLog(recording)

    def log_zones(self) -> None:
        """Log the outlines of the zones, once enough of the scene was seen."""
        if self._rig.zones:
            outlines, middles = drawn_zones(self._survey)
            lines = rr.LineStrips3D(outlines, colors=ZONE.bytes_rgb, radii=rr.Radius.ui_points(1.0))
            self._recording.log("world/zones", lines, static=True)
            texts = rr.Points3D(middles, colors=ZONE.bytes_rgb, radii=0.0, show_labels=True)
            self._recording.log("world/zones/counts", texts, static=True)  # each frame has its own labels

    def log(self, drawn: DrawnObjects) -> None:
        """Log the objects of a frame at the time that is set."""
        result, log, strong = drawn.result, self._recording.log, drawn.strong
        seen, thin = strong & ~drawn.thin, strong & drawn.thin
        looks: list[archetypes.Look] = ["strong" if one else "thin" for one in seen.tolist()]
        self.tracks.log(drawn, looks)
        for path, rows in (("world/objects", seen), ("world/placed", thin), ("world/faint", ~strong)):
            if self._news.at(path, int((alone := rows & (drawn.tracks == NO_TRACK)).sum())):
                shown = archetypes.objects_3d(drawn, alone, "strong" if path == "world/objects" else "thin")
                log(path, shown, archetypes.object_facts(drawn, alone))
        if self._news.at("world/headings", int(seen.sum())):
            log("world/headings", archetypes.heading_arrows(drawn, seen))
        if self._news.at(LABELS, int(strong.sum())):
            self._log_texts(drawn)
        if self._rig.zones:
            log("world/zones/counts", rr.Points3D.from_fields(labels=zone_texts(self._rig, drawn.boxes.centers)))
        if self._news.at("world/uncertainty", int(thin.sum())):
            log("world/uncertainty", archetypes.ellipses(drawn.boxes.select(thin), drawn.colors[thin]))
        paths = self._trails.add_frame(result)
        if self._news.at("world/trails", sum(len(path) > 0 for path in paths)):
            log("world/trails", archetypes.trails(drawn, paths))
        if (found := result.detections.placed) is not None:
            if self._news.at(PLACED, len(found)):
                log(PLACED, archetypes.placed_boxes(found, self._config.object_names))
                log(f"{PLACED}/uncertainty", archetypes.ellipses(found, np.tile(CAMERA_ONLY, (len(found), 1))))
            self._has_placed = True
        elif self._has_placed:
            log(PLACED, rr.Clear(recursive=True))
            self._has_placed = False
            self._news.add(PLACED)

    def _log_texts(self, drawn: DrawnObjects) -> None:
        """The labels of objects, apart as the first view's eye sees them, and their numbers for the view from above."""
        places, strong = self._label_places.of(drawn), drawn.strong
        self._recording.log(LABELS, archetypes.object_texts(drawn, drawn.labels, places, strong))
        self._recording.log(f"{LABELS}/lines", archetypes.label_lines(drawn, places, strong))
        numbers = [f"#{number}" for number in drawn.tracks.tolist()]
        has_track = strong & (drawn.tracks != NO_TRACK)
        self._recording.log(NUMBERS, archetypes.object_texts(drawn, numbers, drawn.roofs, has_track))
