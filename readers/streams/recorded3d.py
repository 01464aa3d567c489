"""Recorded 3D boxes of the messages of a frame, in the site frame at the frame's time."""

from collections import Counter

import numpy as np

from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.detections import Boxes3D, Source
from lidcam.pipeline.core.errors import MessageError
from lidcam.pipeline.core.frame import Decoded, SensorBundle, own_motion
from lidcam.pipeline.core.geometry.posed_boxes import upright_boxes
from lidcam.pipeline.core.messages import RawMessage
from lidcam.pipeline.core.rig import RecordedDetector, Rig
from lidcam.pipeline.core.settings.config import Config
from lidcam.readers.messages.objects import FoundObjects, ObjectClasses
from lidcam.readers.messages.registry import decode_as
from lidcam.readers.streams.decoders import OnBadMessage, decode_each


class RecordedBoxes3D:
    """Decodes the 3D boxes of all recorded detectors.

    Boxes in a frame that is fixed to the site frame are brought to the frame's time by its motion, as clouds are. Boxes
    in the frame that the site frame moves in are placed by its pose at the frame's time. How the objects themselves
    moved in between is not known here: `Boxes3D.measured_ns` says when they were there.
    """

    def __init__(self, rig: Rig, config: Config, *, on_bad: OnBadMessage) -> None:
        self._rig, self._config, self._on_bad = rig, config, on_bad
        self._detectors = {detector.topic: detector for detector in rig.detectors}
        self._classes = ObjectClasses(config.class_id_of_label, config.detect3d.recorded.class_numbers)
        self._min_score = config.detect3d.min_score

    def __call__(self, bundle: SensorBundle) -> Decoded[Boxes3D]:
        """Boxes by name of the detector."""
        unused: Counter[str] = Counter()

        def decode_one(message: RawMessage) -> Boxes3D:
            detector = self._detectors[message.topic]
            found: FoundObjects = decode_as("3D boxes", message, self._classes, limits=self._config.limits)
            T_site_frame = self._pose(detector, found.frame_id or detector.frame_id, found.stamp_ns, bundle)
            unused.update(found.unused)
            sure = found.scores >= np.float32(self._min_score)
            unused[f"score under detect3d.min_score ({self._min_score:g})"] += int((~sure).sum())
            return self._in_site(found, np.flatnonzero(sure), T_site_frame, bundle.stamp_ns)

        topics = {detector.name: topic for topic, detector in self._detectors.items()}
        decoded = decode_each(bundle, topics, decode_one, self._on_bad)
        return Decoded(dict(decoded), decoded.drops, dict(sorted((+unused).items())))

    def _pose(self, detector: RecordedDetector, frame: str, stamp_ns: int, bundle: SensorBundle) -> F64:
        """(4, 4) T_site_frame from where the boxes were at their stamp to the site frame at the frame's time.

        Raises MessageError if nothing joins the frames at that time, and FrameError if the motion is of another frame.
        """
        motion_config, site_frame = self._config.combine.motion, self._rig.site_frame
        if frame in detector.T_site_frame:
            T_site_frame = detector.T_site_frame[frame].matrix
            moved = own_motion(bundle, stamp_ns, site_frame, motion_config) if stamp_ns != bundle.stamp_ns else None
            return T_site_frame if moved is None else np.asarray(moved @ T_site_frame)
        if frame not in detector.T_fixed_frame:
            raise MessageError(
                f"{detector.topic}: its boxes are in frame {frame!r}, which nothing joins with the site frame"
            )
        motion = bundle.motion_of(site_frame) if motion_config.enabled else None
        if motion is None or not motion.covers(bundle.stamp_ns):
            raise MessageError(
                f"{detector.topic}: its boxes are in frame {frame!r}, and where the site frame was in it is not known"
            )
        (now,) = motion.at(bundle.stamp_ns)
        return np.asarray(np.linalg.inv(now) @ detector.T_fixed_frame[frame].matrix, np.float64)

    def _in_site(self, found: FoundObjects, rows: np.ndarray, T_site_frame: F64, stamp_ns: int) -> Boxes3D:
        upright = upright_boxes(found.boxes.select(rows), T_site_frame)
        return Boxes3D(
            stamp_ns,
            self._rig.site_frame,
            upright.centers,
            upright.sizes,
            upright.yaws,
            found.scores[rows],
            found.class_ids[rows],
            np.zeros(len(rows), np.int32),
            upright.covariances,
            np.full(len(rows), Source.LIDAR, np.uint8),
            np.full(len(rows), found.stamp_ns, np.int64),
        )
