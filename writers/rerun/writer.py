"""Writes FrameResults to a Rerun recording: cloud, images, 2D and 3D boxes, transforms, and a layout.

`world` is the site frame. A frame is logged at its stamp (timeline `stamp`) and index (`frame`). Rerun's global
recording is not used. Equal results give equal data, but not equal bytes (Rerun's row ids come from the clock): compare
with `rerun rrd compare --unordered`.
"""

import json
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import rerun as rr

from lidcam.pipeline.core.frame import FrameResult
from lidcam.pipeline.core.geometry.transform import Transform
from lidcam.pipeline.core.messages import Drop, RawMessage
from lidcam.pipeline.core.optics.images import Image
from lidcam.pipeline.core.rig import Rig
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.core.text import visible
from lidcam.pipeline.core.true_boxes import TrueBoxes
from lidcam.writers.base import ResultWriter
from lidcam.writers.drawing import DrawnObjects, height_range, object_edges
from lidcam.writers.outputs.errors import output_errors
from lidcam.writers.outputs.transaction import OutputFile
from lidcam.writers.palette import CAMERA_ONLY, MATCHED, TRUTH, ZONE, class_color
from lidcam.writers.provenance import Provenance
from lidcam.writers.rerun import archetypes
from lidcam.writers.rerun.blueprint import FIXED, LEGEND, LOG, VEHICLE, WAY, blueprint, camera_path, place_eye
from lidcam.writers.rerun.environment import without_rerun_variables
from lidcam.writers.rerun.objects import CameraLog, ObjectLog
from lidcam.writers.rerun.stream import RerunStream
from lidcam.writers.rerun.viewer import RerunViewer
from lidcam.writers.truth_times import FrameTime, TruthTimes
from lidcam.writers.viewpoint import SceneSurvey, Viewpoint, front_of_rig

FLUSH_TICK_S = 86400
"""Rerun cuts data into chunks by size and by this time; a day, so that the clock decides nothing."""
SHOWN_TICK_S = 0.1
"""The same time for the viewer, which shows a chunk when it has it."""
MAX_WAITING_BYTES, MAX_WAITING_FRAMES = 1 << 26, 1000
"""Images and points, and frames, that are logged before the writer waits until they are in the file."""
POINT_BYTES = 16
"""Position and colour."""


class RerunResultWriter(ResultWriter):
    """Writes one run's frames to a file, or without an `output` shows each in the viewer when it is given.

    The recording id is equal for equal inputs and settings. JPEG and PNG are passed through; `decode_any_image` decodes
    other images.
    """

    def __init__(
        self,
        output: OutputFile | None,
        rig: Rig,
        config: Config,
        provenance: Provenance,
        *,
        decode_any_image: Callable[[RawMessage], Image],
    ) -> None:
        self.name = "view" if output is None else "rerun"
        self._output, self._rig, self._config = output, rig, config
        self.path = Path("--view") if output is None else output.path
        self._provenance, self._decode = provenance, decode_any_image
        self._recording: rr.RecordingStream
        self._survey = SceneSurvey(rig)
        self._viewpoint: Viewpoint | None = None
        self._first: tuple[int, int] | None = None
        self._object_count = self._confirmed_count = 0
        self._last_ns: int | None = None
        self._seconds = 0.0  # without steps back
        self._heights: tuple[float, float] | None = None
        self._last_place: list[float] | None = None
        self._has_vehicle = False
        self._truth_times = TruthTimes()
        self._nearest_truth: tuple[FrameTime, TrueBoxes] | None = None
        self._fixed_frame_id: str | None = None
        self._explained = 0
        self._frames = self._waiting_bytes = 0

    def _open(self, resources: ExitStack) -> None:
        file = None if self._output is None else resources.enter_context(self._output.part.open("xb", buffering=0))
        resources.enter_context(without_rerun_variables())
        self._recording = rr.RecordingStream(
            "lidcam",
            recording_id=None if file is None else self._provenance.recording_id,
            send_properties=False,
            batcher_config=rr.ChunkBatcherConfig(flush_tick=SHOWN_TICK_S if file is None else FLUSH_TICK_S),
        )
        self._recording.set_log_time_enabled(False)
        self._recording.set_log_tick_enabled(False)
        self._objects = ObjectLog(self._recording, self._rig, self._config, self._survey)
        self._cameras = CameraLog(self._recording, self._rig, self._config, self._decode)
        self._stream: RerunStream | RerunViewer
        self._stream = RerunViewer(self._recording) if file is None else RerunStream(self._recording, file, self.path)
        resources.callback(lambda: self._stream.discard())  # does nothing after `finish`
        title = ", ".join(known["name"] for known in self._provenance.inputs)
        self._recording.send_recording_name(visible(title) or "lidcam")

    def _finish(self) -> None:
        if self._first is not None:
            viewpoint = self._viewpoint or self._place_eye()
            if self._output is not None:  # all objects are known now, and in view from above
                self._send_blueprint(viewpoint)
            self._send_figures()
        self._log_warnings()
        self._log_truth(self._truth_times.rest(), is_last=True)
        self._stream.finish()

    def write(self, result: FrameResult) -> tuple[Drop, ...]:
        """Log one frame; returns its images that cannot be decoded."""
        with output_errors(self.path):
            self._stream.check()
        if self._first is None:
            self._first = result.bundle.index, result.bundle.stamp_ns
            self._log_static()
        self._survey.add_frame(result)
        if self._viewpoint is None and (self._survey.is_complete or self._output is None):  # who looks on does not wait
            viewpoint = self._place_eye()
            if self._output is None:
                self._send_blueprint(viewpoint)
        if result.bundle.motion is not None:
            self._fixed_frame_id = result.bundle.motion.fixed_frame_id
        self._log_truth(self._truth_times.add_frame(result.bundle))
        self._set_time(result.bundle.index, result.bundle.stamp_ns)
        self._log_motion(result)
        if self._config.output.clouds:
            self._log_clouds(result)
        drawn = DrawnObjects.of(result, self._config.object_names)
        self._objects.log(drawn)
        drops: list[Drop] = []
        edges = object_edges(result, [camera.name for camera in self._rig.cameras])
        for camera in self._rig.cameras:
            drops += self._cameras.log(camera, drawn, edges[camera.name])
        objects, confirmed = len(result.fused.objects), int((result.fused.matched > 0).sum())
        metrics = {"objects": objects, "confirmed": confirmed, "skew_ms": result.bundle.skew_ns / 1e6}
        for name, value in metrics.items():
            self._recording.log(f"metrics/{name}", rr.Scalars(float(value)))
        self._object_count, self._confirmed_count = self._object_count + objects, self._confirmed_count + confirmed
        stamp_ns = result.bundle.stamp_ns
        self._seconds += 0.0 if self._last_ns is None else max(stamp_ns - self._last_ns, 0) / 1e9
        self._last_ns = stamp_ns
        for drop in (*result.drops, *drops):
            text = ": ".join(filter(None, (drop.topic, drop.reason, drop.detail)))
            self._recording.log(f"{LOG}/dropped", rr.TextLog(text, level=rr.TextLogLevel.WARN))
        with output_errors(self.path):
            self._bound_memory()
        return tuple(drops)

    def _log_warnings(self) -> None:
        """The warnings of the run, known at its end, logged at the time of its first frame."""
        if self._first is None:
            return
        self._set_time(*self._first)
        for name, codec in self._cameras.codecs.items():
            if codec != "av1":
                text = f"{name}: {codec} video, as recorded: Rerun shows it where FFmpeg is installed, or in a browser"
                self._recording.log(f"{LOG}/run", rr.TextLog(text, level=rr.TextLogLevel.INFO))
        for warning in json.loads(self._provenance.summary()).get("warnings", ()):
            text = f"{warning['subject']}: {warning['finding']}; {warning['remedy']}"
            self._recording.log(f"{LOG}/run", rr.TextLog(text, level=rr.TextLogLevel.WARN))

    def _send_figures(self) -> None:
        """The properties of the recording: where the result comes from, and what was seen."""
        assert self._first is not None
        names, counts = self._config.object_names, Counter(self._objects.tracks.classes.values())
        known = self._provenance.metadata()
        figures = rr.AnyValues(
            version=known["version"],
            settings=known["settings"],
            frames=self._frames,
            seconds=self._seconds,
            road_users=", ".join(f"{count} {names[class_id]}" for class_id, count in sorted(counts.items())),
            objects=self._object_count,
            confirmed_by_cameras=self._confirmed_count,
            fastest_m_s=self._objects.tracks.fastest_m_s,
            recorded_video=", ".join(f"{name}: {codec}" for name, codec in self._cameras.codecs.items()),
        )
        self._recording.send_property("lidcam", figures)

    def _bound_memory(self) -> None:
        """Wait for the disk now and then; what decides when is the data, as this cuts them into chunks."""
        self._frames += 1
        waiting = self._waiting_bytes + self._cameras.waiting_bytes
        if waiting >= MAX_WAITING_BYTES or self._frames % MAX_WAITING_FRAMES == 0:
            self._stream.flush()
            self._waiting_bytes = self._cameras.waiting_bytes = 0

    def _place_eye(self) -> Viewpoint:
        """Log what is drawn in the scene's own measure, which is known once enough of it was seen."""
        self._viewpoint = viewpoint = place_eye(self._survey)
        for lidar in self._rig.lidars:
            axes = rr.TransformAxes3D(viewpoint.size_m * 0.04)
            self._recording.log(f"world/lidars/{lidar.name}", _transform(lidar.T_site_lidar), axes, static=True)
        for camera in self._rig.cameras:
            pinhole = rr.Pinhole(
                image_from_camera=camera.model.K,
                width=camera.model.width_px,
                height=camera.model.height_px,
                camera_xyz=rr.ViewCoordinates.RDF,
                image_plane_distance=viewpoint.size_m * 0.08,
            )
            no_axes = rr.TransformAxes3D(0.0)  # the pinhole says enough
            pose = _transform(camera.T_camera_site.inverse())
            self._recording.log(camera_path(camera), pose, pinhole, no_axes, static=True)
        self._objects.log_zones()
        return viewpoint

    def _send_blueprint(self, viewpoint: Viewpoint) -> None:
        is_tracked = self._config.track.mode != "none"
        self._recording.send_blueprint(blueprint(self._survey, viewpoint, is_tracked=is_tracked))

    def _log_static(self) -> None:
        named = [(name, class_color(class_id).bytes_rgb) for class_id, name in enumerate(self._config.object_names)]
        context = rr.AnnotationContext([rr.AnnotationInfo(row, *one) for row, one in enumerate(named)])
        named += [("2D box, matched", MATCHED.bytes_rgb), ("2D box alone", CAMERA_ONLY.bytes_rgb)]
        self._explain("boxes", [*named, *[("zone", ZONE.bytes_rgb)] * bool(self._rig.zones)])
        self._recording.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, context, static=True)
        for path, color, label in (
            ("objects", class_color(0), "objects"),
            ("confirmed", MATCHED, "confirmed by cameras"),
            ("skew_ms", CAMERA_ONLY, "sync skew (ms)"),
        ):
            lines = rr.SeriesLines(colors=color.bytes_rgb, names=label)
            self._recording.log(f"metrics/{path}", lines, static=True)

    def _explain(self, part: str, named: Sequence[tuple[str, tuple[int, int, int]]]) -> None:
        """Add colours to the legend, on a line of their own: only what is in the recording has a place in it."""
        self._recording.log(f"{LEGEND}/{part}", archetypes.legend(named, self._explained), static=True)
        self._explained += len(named) + len(named) % 2

    def _log_motion(self, result: FrameResult) -> None:
        """The vehicle, the frame in which it moves, seen from the vehicle, and its step since the frame before."""
        motion, stamp_ns = result.bundle.motion, result.bundle.stamp_ns
        if not self._has_vehicle and (motion is not None or result.odometry is not None):
            middle = np.array([*self._survey.middle[:2], self._survey.ground_m])
            self._recording.log(VEHICLE, archetypes.own_vehicle(middle, front_of_rig(self._rig)), static=True)
            self._explain("own", [("own vehicle", archetypes.OWN_VEHICLE), ("own path", archetypes.WAY)])
            self._has_vehicle = True
        if motion is None:
            return
        if not motion.covers(stamp_ns):
            self._recording.log(FIXED, rr.Transform3D(scale=0.0))  # hides the way: where it lies is not known
            self._last_place = None
            return
        pose = motion.at(stamp_ns)[0]
        self._recording.log(FIXED, _transform(Transform(motion.fixed_frame_id, motion.frame_id, pose).inverse()))
        place = pose[:3, 3].tolist()
        step = [self._last_place or place, place]
        self._recording.log(WAY, rr.LineStrips3D([step], colors=archetypes.WAY, radii=rr.Radius.ui_points(2.0)))
        self._last_place = place

    def _log_clouds(self, result: FrameResult) -> None:
        self._heights = self._heights or height_range(result.combined)
        self._waiting_bytes += POINT_BYTES * (len(result.combined.cloud) + len(result.combined.ground_cloud))
        self._recording.log("world/cloud", archetypes.cloud_points(result.combined, self._heights or (0.0, 1.0)))
        self._recording.log("world/ground", archetypes.ground_points(result.combined))

    def _log_truth(self, known: Iterable[tuple[FrameTime, TrueBoxes]], *, is_last: bool = False) -> None:
        """The truth nearest to each frame, if it stands in the site frame or in the one it moves in.

        It is logged when truth of another frame comes, or with the last.
        """
        places = {self._rig.site_frame: "world/truth", self._fixed_frame_id: f"{FIXED}/truth"}
        found = [self._nearest_truth] if self._nearest_truth is not None else []  # of each frame the nearest one
        for frame, truth in known:
            if truth.frame_id in places:
                same = [found.pop()] if found and found[-1][0] == frame else []
                found.append(min([*same, (frame, truth)], key=lambda one: abs(one[1].stamp_ns - one[0].stamp_ns)))
        if found and self._nearest_truth is None:
            self._explain("truth", [("ground truth", TRUTH.bytes_rgb)])
        self._nearest_truth = found[-1] if found else None
        for frame, truth in found if is_last else found[:-1]:
            self._set_time(frame.index, frame.stamp_ns)
            self._recording.log(places[truth.frame_id], archetypes.truth_boxes(truth))

    def _set_time(self, index: int, stamp_ns: int) -> None:
        self._recording.set_time("frame", sequence=index)
        self._recording.set_time("stamp", timestamp=np.datetime64(stamp_ns, "ns"))


def _transform(transform: Transform) -> rr.Transform3D:
    quaternion = rr.Quaternion(xyzw=transform.quaternion_xyzw)
    return rr.Transform3D(translation=transform.translation, quaternion=quaternion)
