"""Explains runs without a single object: the step that left nothing, and the remedy."""

from lidcam.pipeline.core.frame import FrameResult
from lidcam.pipeline.core.rig import Rig
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.detectors.cluster.detector import ClusterDetector
from lidcam.readers.recording import Recording
from lidcam.run.choice import UsedSettings
from lidcam.run.scene import MODEL_EXTENT_M, judge, measure_scene, scene_text
from lidcam.run.warning import RunWarning


class ObjectCheck:
    """Keeps the frame that came closest to an object while there is none, and examines it at the end of the run."""

    def __init__(self, recording: Recording, rig: Rig, config: Config, settings: UsedSettings, *, moves: bool) -> None:
        """Prepare for a run with these settings; `moves`: the site frame is known to move."""
        self._recording, self._rig, self._config = recording, rig, config
        self._settings, self._moves = settings, moves
        self._closest: FrameResult | None = None
        self._best: tuple[float, ...] = ()
        self._any = False

    def add_frame(self, frame: FrameResult) -> None:
        """Add one frame."""
        self._any = self._any or len(frame.fused.objects) > 0
        if self._any:
            self._closest = None
            return
        left_out, unused = sum(frame.fused.left_out.values()), sum(frame.unused_boxes3d.values())
        heard = sum(detector.topic in frame.bundle.messages for detector in self._rig.detectors)
        rank = (left_out, float(frame.beliefs.max(initial=0)), unused, heard, frame.combined.counts["left"])
        if rank > self._best:
            self._closest, self._best = frame, rank

    @property
    def warnings(self) -> tuple[RunWarning, ...]:
        """One if there were frames, and no object in any."""
        if self._closest is None:
            return ()
        finding, remedy = self._lost_at(self._closest)
        return (RunWarning("no objects", f"frame {self._closest.bundle.index} came closest: {finding}", remedy),)

    def _lost_at(self, frame: FrameResult) -> tuple[str, str]:
        """The step that left no objects, and what to try."""
        config, counts, boxes = self._config, frame.combined.counts, frame.hypotheses.boxes
        measured = counts["input"] - counts["nan"]
        if left_out := frame.fused.left_out:
            reasons = ", ".join(f"{count} {reason}" for reason, count in left_out.items())
            return f"its objects are not reported: {reasons}", "see the zones of the rig file, or rig.zones"
        if len(boxes):
            return self._lost_in_fusion(frame)
        if config.detect3d.method == "recorded":
            return self._lost_in_recording(frame)
        if config.detect3d.method == "none":
            return "detect3d.method is none, so that nothing is detected", "--set detect3d.method=auto"
        if measured == 0:
            return "its clouds have no points", "see the lidars and their drivers"
        if counts["range"] == measured:
            limits = f"{config.combine.min_range_m:g} to {config.combine.max_range_m:g} m"
            return (
                f"all {measured} points are nearer or further than combine.min_range_m and max_range_m allow, {limits}",
                self._remedy("set other limits"),
            )
        if len(frame.combined.detection_cloud) == 0:
            return (
                f"of {measured - counts['range']} points in range, {counts['ground']} were removed as ground, which "
                "leaves none to detect in",
                self._remedy(f"a smaller combine.ground.distance_m than {config.combine.ground.distance_m:g} may help"),
            )
        return self._lost_in_detection(frame, config)

    def _lost_in_fusion(self, frame: FrameResult) -> tuple[str, str]:
        return (
            f"the most probable of its {len(frame.beliefs)} boxes has a probability of {frame.beliefs.max():.2f}, less "
            f"than fuse.min_score, {self._config.fuse.min_score:g}",
            self._remedy("a smaller fuse.min_score shows them"),
        )

    def _lost_in_recording(self, frame: FrameResult) -> tuple[str, str]:
        topics = [detector.topic for detector in self._rig.detectors]
        if frame.unused_boxes3d:
            reasons = "; ".join(f"{count}, {reason}" for reason, count in frame.unused_boxes3d.items())
            remedy = "see detect3d.min_score, the labels of classes, and detect3d.recorded.class_numbers"
            return f"its recorded 3D boxes are not used: {reasons}", remedy
        if not any(topic in frame.bundle.messages for topic in topics):
            return f"it has no message of {', '.join(topics)}", "see sync.slop_s and topics.boxes3d"
        return f"the messages of {', '.join(topics)} have no boxes", "see that detector, or topics.boxes3d"

    def _lost_in_detection(self, frame: FrameResult, config: Config) -> tuple[str, str]:
        found = ClusterDetector(self._rig, config)(frame.combined)
        scores = found.scores[found.class_ids >= 0]
        left = len(frame.combined.detection_cloud)
        if len(scores) and scores.max() >= config.detect3d.min_score:
            return (
                f"none of its {len(scores)} clusters is as probable as detect3d.min_score, "
                f"{config.detect3d.min_score:g}",
                self._remedy("a smaller detect3d.min_score shows them"),
            )
        if len(scores):
            return (
                f"the best of {len(scores)} clusters scores {scores.max():.3f}, less than detect3d.min_score, "
                f"{config.detect3d.min_score:g}",
                self._remedy("a smaller detect3d.min_score shows them"),
            )
        return (
            f"no cluster of the {left} points above the ground has the size of a class",
            self._remedy("see detect3d.cluster and the sizes of classes, unless there is nothing to detect"),
        )

    def _remedy(self, otherwise: str) -> str:
        """Other settings, if those in use are not what the recording calls for."""
        size = self._settings.size or measure_scene(self._recording, self._rig, self._config)
        if size is None:
            return otherwise
        preset, condition = judge(size, moves=self._moves), ""
        if size.lidar_height_m is None:  # the extent alone says little
            preset = "sandbox" if size.extent_m[0] < MODEL_EXTENT_M else self._settings.name
            condition = " if this is a model site"
        if preset == self._settings.name:
            return otherwise
        return f"{scene_text(size, moves=self._moves)}: try --config {preset}{condition}; else {otherwise}"
