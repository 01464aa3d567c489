"""All settings, one model per stage, with defaults.

A YAML file overrides single values; an unknown key is an error. `config/default.yaml` is a printed copy of the
defaults. The wiring of the stages is not a setting: see `lidcam/run/build.py`.
"""

from collections.abc import Mapping
from typing import Annotated, ClassVar

from pydantic import Field, model_validator

from lidcam.pipeline.core.settings.classes import ROAD_CLASSES, ClassPrior
from lidcam.pipeline.core.settings.combine import CombineConfig
from lidcam.pipeline.core.settings.detect import Detect2DConfig, Detect3DConfig
from lidcam.pipeline.core.settings.evaluate import EvaluateConfig
from lidcam.pipeline.core.settings.fuse import FuseConfig
from lidcam.pipeline.core.settings.model import Positive, SettingsModel
from lidcam.pipeline.core.settings.recording import (
    DEFAULT_LIMITS,
    RecordingLimits,
    RigConfig,
    TopicsConfig,
    VelodyneConfig,
)
from lidcam.pipeline.core.settings.run import OutputConfig, RunConfig, TrackConfig
from lidcam.pipeline.core.settings.sync import SyncConfig

ALL_CLASSES = "all"
"""Class name of the figures over all classes."""

UNKNOWN_CLASS = "unknown"
"""Name of objects of no class; their class id is the number of classes."""


def _constant(value: float) -> str:
    return f"now a constant of {value:g}"


class Config(SettingsModel):
    """All settings of one run.

    Attributes:
        limit_scale: Multiplies the limits that keep a damaged or hostile recording from filling memory or disk: sizes
            of messages, images and clouds, waiting messages, and the time of a server's answer. Valid recordings stay
            far below them.
        classes: Classes to detect; the position of a class is its class id.
    """

    GONE: ClassVar[Mapping[str, str]] = {
        "velodyne.topics": "velodyne.model and velodyne.calibration hold for all lidars",
        "topics.last_resort": "now a constant: /point_cloud_combined and /ground_cloud",
        "sync.policy": "now always approximate_time; other topics join nearest to one in sync.required",
        "sync.age_penalty": _constant(0.1),
        "combine.motion.max_extrapolation_s": _constant(0.2),
        "combine.motion.max_gap_s": _constant(1.5),
        "combine.outliers.neighbors": _constant(10),
        "combine.ground.relief": "the ground's relief is always taken into account",
        "combine.ground.iterations": _constant(200),
        "combine.ground.seed": _constant(0),
        "detect3d.cluster.height_weight": _constant(0.5),
        "detect3d.cluster.split_shares": _constant(0.7),
        "detect3d.recorded.position_sigma_m": _constant(0.3),
        "detect3d.recorded.yaw_sigma_deg": _constant(10.0),
        "detect2d.nms_iou": _constant(0.45),
        "detect2d.nms_iou_any": _constant(0.6),
        "detect2d.threads": _constant(1),
        "associate": "now constants of pipeline/core/association.py",
        "fuse.min_score_unconfirmed": "fuse.min_score is a probability, with cameras and without",
        "fuse.heading_sigma_deg": _constant(5.0),
        "evaluate.ranges_m": "now a constant: 0, 10, 20, 40 and 80 m, scaled by the length of the first class",
        "evaluate.min_image_pixels": _constant(1),
        "evaluate.bootstrap": _constant(1000),
        "evaluate.distances": "scaled by the length of the class; for nuScenes's own figures, export",
        "fuse.camera_recall": "learned for each camera and size while the run goes on",
        "fuse.size_sigma": _constant(0.15),
        "fuse.corner_rounding": _constant(0.25),
        "fuse.underside": _constant(0.06),
        "fuse.cabin": _constant(0.4),
        "compare": "now constants of pipeline/evaluation/comparison/object_changes.py; see --allow and --max-different",
        "run.window": "now two frames per process and one more: use run.workers",
        "limits": "use limit_scale, which multiplies all limits",
    }
    """Successors of the settings of earlier versions."""

    topics: TopicsConfig = TopicsConfig()
    rig: RigConfig = RigConfig()
    velodyne: VelodyneConfig = VelodyneConfig()
    sync: SyncConfig = SyncConfig()
    combine: CombineConfig = CombineConfig()
    detect3d: Detect3DConfig = Detect3DConfig()
    detect2d: Detect2DConfig = Detect2DConfig()
    fuse: FuseConfig = FuseConfig()
    track: TrackConfig = TrackConfig()
    evaluate: EvaluateConfig = EvaluateConfig()
    output: OutputConfig = OutputConfig()
    run: RunConfig = RunConfig()
    limit_scale: Positive = 1.0
    classes: Annotated[tuple[ClassPrior, ...], Field(min_length=1)] = ROAD_CLASSES

    @model_validator(mode="after")
    def _names_are_unique(self) -> "Config":
        names = [prior.known_as[0] for prior in self.classes]
        if len(set(names)) < len(names):
            raise ValueError(f"classes: a name is used twice in {', '.join(names)}")
        if UNKNOWN_CLASS in names:
            raise ValueError(f"classes: {UNKNOWN_CLASS!r} is what is of no class (fuse.unknown); expected another name")
        if ALL_CLASSES in names:
            raise ValueError(f"classes: {ALL_CLASSES!r} names the figures of all classes; expected another name")
        return self

    @property
    def limits(self) -> RecordingLimits:
        """The limits of a recording, scaled."""
        return DEFAULT_LIMITS.scaled(self.limit_scale)

    @property
    def class_names(self) -> tuple[str, ...]:
        """Names by class id."""
        return tuple(prior.name for prior in self.classes)

    @property
    def object_names(self) -> tuple[str, ...]:
        """Names by class id of fused objects, of which some may be of no class, if `fuse.unknown` is on."""
        return (*self.class_names, UNKNOWN_CLASS) if self.fuse.unknown else self.class_names

    @property
    def class_id_of_label(self) -> dict[str, int]:
        """Class id by label of a detector or of truth, or by the class's own name; in small letters (`known_as`).

        Of two classes with one label the last has it.
        """
        return {label: class_id for class_id, prior in enumerate(self.classes) for label in prior.known_as}
