"""All settings, one model per stage, with defaults.

A YAML file overrides single values; an unknown key is an error. `config/default.yaml` is a printed copy of the
defaults. The wiring of the stages is not a setting: see `lidcam/run/build.py`.
"""

from typing import Annotated

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


class Config(SettingsModel):
    """All settings of one run.

    Attributes:
        limit_scale: Multiplies the limits that keep a damaged or hostile recording from filling memory or disk: sizes
            of messages, images and clouds, waiting messages, and the time of a server's answer. Valid recordings stay
            far below them.
        classes: Classes to detect; the position of a class is its class id.
    """

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
