"""The settings: one model per stage, defaults in code, units in names.

A YAML file overrides single values; a key that no model knows is an error, never ignored. `config/default.yaml` is a
printed copy of the defaults. Parameters only: how stages are wired is said in `lidcam/build.py`.
"""

from pathlib import Path
from typing import Annotated, Any, Literal, get_args

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from pipeline.core.errors import ConfigError

__all__ = [
    "DEFAULT_LIMITS",
    "MOST_YAML_BYTES",
    "AssociateConfig",
    "ClassPrior",
    "CombineConfig",
    "Config",
    "Detect2DConfig",
    "Detect3DConfig",
    "FuseConfig",
    "GroundConfig",
    "LimitsConfig",
    "MotionConfig",
    "OutlierConfig",
    "OutputConfig",
    "RigConfig",
    "RunConfig",
    "SyncConfig",
    "TopicsConfig",
    "VelodyneConfig",
    "VelodyneLidarConfig",
    "describe_validation",
    "dump_config",
    "load_config",
    "parse_yaml",
    "read_yaml",
]

Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
Share = Annotated[float, Field(ge=0, le=1)]
Count = Annotated[int, Field(ge=1)]

MOST_YAML_BYTES = 1 << 20
MOST_YAML_BRACKETS = 30
"""Brackets in one another; PyYAML looks at all of them again at every word."""

MOST_YAML_VALUES = 100_000
"""Values in a file, each alias counted as what it stands for: a few lines of them can stand for billions."""


class _Model(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class ClassPrior(_Model):
    """What is known of a class of road users before anything is measured.

    Attributes:
        name: Class name in the results.
        size_m: Typical length, width, height.
        size_max_m: A measured box larger than this is not of this class.
        frequency: How common the class is, against the others; decides between classes that fit equally well.
        labels: Names that 2D detectors use for it (COCO names for instance).
    """

    name: str
    size_m: tuple[Positive, Positive, Positive]
    size_max_m: tuple[Positive, Positive, Positive]
    frequency: Positive = 1.0
    labels: tuple[str, ...] = ()


class TopicsConfig(_Model):
    """Which topics take part; empty means all that fit.

    Attributes:
        lidars: Topics of clouds.
        cameras: Topics of images.
        exclude: Topics that are not used, by name or shell pattern.
        last_resort: Topics, by name or shell pattern, that were made of others: used only where nothing else of their
            kind was recorded. Parts of combined messages go before them, and after all that was recorded by itself.
    """

    lidars: tuple[str, ...] = ()
    cameras: tuple[str, ...] = ()
    exclude: tuple[str, ...] = ()
    last_resort: tuple[str, ...] = ("/point_cloud_combined",)


class RigConfig(_Model):
    """What is assumed of the rig.

    Attributes:
        site_frame: Frame that clouds are combined and objects reported in; empty: the rig file's, else `base_link` if
            the lidars are fixed to it, else the frame that they are all fixed to.
    """

    site_frame: str = ""


class VelodyneLidarConfig(_Model):
    """What the packets of a Velodyne do not say of themselves.

    Attributes:
        model: `auto` takes what the packets say; VLP-32A and B are alike there, and an HDL-64E says nothing.
        calibration: YAML file of ROS's velodyne driver; empty: the manual's table. An HDL-64E needs one.
    """

    model: Literal[
        "auto",
        "VLP-16",
        "Puck Hi-Res",
        "HDL-32E",
        "HDL-64E S2",
        "HDL-64E S3",
        "VLP-32A",
        "VLP-32B",
        "VLP-32C",
        "VLS-128",
    ] = "auto"
    calibration: str = ""


class VelodyneConfig(VelodyneLidarConfig):
    """Raw packets of Velodyne lidars (velodyne_msgs): the settings for all, and for single ones.

    Attributes:
        topics: The same two settings by topic, instead of those above.
    """

    topics: dict[str, VelodyneLidarConfig] = {}


class SyncConfig(_Model):
    """How messages of one moment are found.

    Attributes:
        policy: `approximate_time` (message_filters in C++), `approximate_time_python` (the original's) or `nearest`.
        reference: Topic whose stamp a frame takes; empty: the first lidar's.
        queue_size: Messages kept per topic.
        slop_s: Largest spread of the stamps of a set (python policy: exclusive; nearest: distance to the reference).
        max_interval_s: Largest spread under `approximate_time`; None for no bound, as in ROS.
        age_penalty: How much better a newer set must be under `approximate_time`.
    """

    policy: Literal["approximate_time", "approximate_time_python", "nearest"] = "approximate_time"
    reference: str = ""
    queue_size: Count = 10
    slop_s: NotNegative = 0.1
    max_interval_s: Positive | None = 0.1
    age_penalty: NotNegative = 0.1


class MotionConfig(_Model):
    """Motion compensation of clouds.

    Attributes:
        enabled: Off leaves points where they were measured.
        topic: nav_msgs/Odometry of the site or vehicle frame; empty: found by its child frame, else by tf.
        max_extrapolation_s: Points measured longer than this before the first or after the last known pose leave their
            cloud uncompensated.
        max_gap_s: Poses further apart than this say nothing of the motion between them.
    """

    enabled: bool = True
    topic: str = ""
    max_extrapolation_s: NotNegative = 0.2
    max_gap_s: Positive = 1.0


class OutlierConfig(_Model):
    """Statistical outlier removal by PCL's rule.

    Attributes:
        enabled: Off keeps all points.
        neighbors: Nearest neighbours that the mean distance is taken over, without the point itself.
        std_ratio: Points further than mean + std_ratio x standard deviation go.
    """

    enabled: bool = True
    neighbors: Count = 10
    std_ratio: float = 1.0


class GroundConfig(_Model):
    """Ground removal by a RANSAC plane that is held to be ground.

    Attributes:
        enabled: Off keeps the ground.
        distance_m: Points nearer to the plane than this belong to it.
        max_tilt_deg: Largest angle between the plane's normal and the site's z axis.
        height_tolerance_m: Largest distance, at the site's origin, from the rig's ground height where that is known.
        iterations: Planes that are tried.
        seed: Of the random choice.
    """

    enabled: bool = True
    distance_m: Positive = 0.2
    max_tilt_deg: Annotated[float, Field(gt=0, lt=90)] = 10.0
    height_tolerance_m: Positive = 0.5
    iterations: Count = 200
    seed: Annotated[int, Field(ge=0)] = 0


class CombineConfig(_Model):
    """How clouds become one.

    Attributes:
        min_range_m: Points nearer to their lidar go (the rig itself).
        max_range_m: Points further from their lidar go.
        motion: Motion compensation.
        outliers: Outlier removal.
        ground: Ground removal.
    """

    min_range_m: NotNegative = 0.0
    max_range_m: Positive = 200.0
    motion: MotionConfig = MotionConfig()
    outliers: OutlierConfig = OutlierConfig()
    ground: GroundConfig = GroundConfig()


class Detect3DConfig(_Model):
    """Detection in the cloud.

    Attributes:
        method: `cluster` needs no weights; `none` finds nothing.
        cluster_distance_m: Points this near belong together, close to a lidar.
        cluster_distance_per_m: Growth of that distance per metre of range (points thin out).
        height_weight: What a metre of height counts against a metre along the ground, when distances are taken.
        split_shares: Clusters that fit no class well are clustered again with these shares of the distance.
        clearance_m: Points lower than this above the ground are not looked at: kerbs and remains of the ground would
            join objects.
        min_points: A cluster of fewer points is noise.
        min_height_m: A cluster lower than this above the ground is a kerb or noise.
        max_bottom_m: A cluster that hovers higher than this above the ground hangs there.
        points_per_sr: Beams of one lidar per steradian: 1 / (vertical x horizontal resolution in radians); what an
            object in full view returns is judged by it.
        min_score: Boxes with a lower score go.
    """

    method: Literal["cluster", "none"] = "cluster"
    cluster_distance_m: Positive = 0.4
    cluster_distance_per_m: NotNegative = 0.01
    height_weight: Positive = 0.5
    split_shares: tuple[Annotated[float, Field(gt=0, lt=1)], ...] = (0.7,)
    clearance_m: NotNegative = 0.3
    min_points: Count = 10
    min_height_m: NotNegative = 0.5
    max_bottom_m: Positive = 1.0
    points_per_sr: Positive = 45_000.0
    min_score: Share = 0.07


class Detect2DConfig(_Model):
    """Detection in pictures.

    Attributes:
        method: `auto`: the model if one is given, else boxes in the recording if there are any, else none.
        model: ONNX file (YOLOX layout); a path relative to the working folder.
        min_score: Boxes with a lower score go.
        nms_iou: Of two boxes of one class that overlap more than this the lower score goes.
        threads: Threads inside the network; fixed, so that results do not depend on the machine. One is cheapest: the
            other cores have the other stages to run.
    """

    method: Literal["auto", "onnx", "recorded", "none"] = "auto"
    model: Path | None = None
    min_score: Share = 0.3
    nms_iou: Share = 0.45
    threads: Count = 1


class AssociateConfig(_Model):
    """Which 3D box is which 2D box.

    Attributes:
        min_iou: Least overlap of the projected 3D box with the 2D box.
        class_penalty: Taken from the overlap where the classes differ, before the best assignment is sought; a pair
            that is worth nothing then is never formed, so with 1 classes must agree.
    """

    min_iou: Share = 0.3
    class_penalty: NotNegative = 0.1


class FuseConfig(_Model):
    """What becomes of matched and unmatched objects.

    Attributes:
        min_score: Objects with a lower score are not reported.
    """

    min_score: Share = 0.0


class OutputConfig(_Model):
    """What is written.

    Attributes:
        images: Whether pictures are copied to the output.
        clouds: Whether the combined cloud is written.
        compression: Of the MCAP's chunks.
    """

    images: bool = True
    clouds: bool = True
    compression: Literal["none", "lz4", "zstd"] = "lz4"


class LimitsConfig(_Model):
    """How much a recording may ask for: no sound one comes near, and a hostile one cannot fill the memory or the disk.

    What goes beyond a limit is treated as damage, and the message names the setting to raise.

    Attributes:
        largest_unpacked_file_gib: What a compressed file, or all chunks of a damaged one, may unpack to; twenty times
            the size of the file where that is more.
        largest_chunk_mib: What a compressed chunk may unpack to.
        largest_message_mib: Largest message, unpacked.
        most_messages_per_chunk: Records in one chunk.
        most_messages_in_memory: Messages of one file whose place is held in memory at once: of chunks that overlap in
            time, and of a damaged file.
        most_topics: Topics of one recording.
        most_points: Points in one cloud.
        largest_picture_mpx: Millions of pixels in one picture.
        most_losses_listed: Damaged places of one file that are listed one by one; the rest is added up.
    """

    largest_unpacked_file_gib: Positive = 16.0
    largest_chunk_mib: Count = 256
    largest_message_mib: Count = 256
    most_messages_per_chunk: Count = 1_000_000
    most_messages_in_memory: Count = 10_000_000
    most_topics: Count = 1000
    most_points: Count = 10_000_000
    largest_picture_mpx: Positive = 100.0
    most_losses_listed: Count = 1000

    @property
    def largest_chunk_bytes(self) -> int:
        """`largest_chunk_mib` in bytes."""
        return self.largest_chunk_mib << 20

    @property
    def largest_message_bytes(self) -> int:
        """`largest_message_mib` in bytes."""
        return self.largest_message_mib << 20

    def largest_unpacked_bytes(self, file_bytes: int) -> int:
        """What a file of `file_bytes` may unpack to, in bytes."""
        return max(round(self.largest_unpacked_file_gib * 2**30), 20 * file_bytes)


DEFAULT_LIMITS = LimitsConfig()


class RunConfig(_Model):
    """How the work is done; none of it changes the result.

    Attributes:
        workers: 1 runs stage after stage; with more, stages run on threads of their own, and more frames overlap.
        window: Frames in work at once; None: two more than workers.
    """

    workers: Count = 2
    window: Count | None = None


_ROAD_CLASSES = (
    ClassPrior(name="car", size_m=(4.0, 1.7, 1.55), size_max_m=(5.6, 2.4, 2.3), labels=("car",)),
    ClassPrior(
        name="pedestrian",
        size_m=(0.6, 0.6, 1.75),
        size_max_m=(1.2, 1.2, 2.1),
        frequency=0.5,
        labels=("person", "pedestrian"),
    ),
    ClassPrior(
        name="bicycle",
        size_m=(1.8, 0.6, 1.7),
        size_max_m=(2.3, 1.1, 2.1),
        frequency=0.2,
        labels=("bicycle", "motorcycle", "cyclist"),
    ),
    ClassPrior(
        name="truck", size_m=(8.0, 2.5, 3.2), size_max_m=(16.0, 3.2, 4.2), frequency=0.2, labels=("truck", "van")
    ),
    ClassPrior(name="bus", size_m=(11.5, 2.55, 3.2), size_max_m=(18.5, 3.2, 4.2), frequency=0.2, labels=("bus",)),
)


class Config(_Model):
    """All settings of one run.

    Attributes:
        classes: What is looked for; the row of a class is its class id.
    """

    topics: TopicsConfig = TopicsConfig()
    rig: RigConfig = RigConfig()
    velodyne: VelodyneConfig = VelodyneConfig()
    sync: SyncConfig = SyncConfig()
    combine: CombineConfig = CombineConfig()
    detect3d: Detect3DConfig = Detect3DConfig()
    detect2d: Detect2DConfig = Detect2DConfig()
    associate: AssociateConfig = AssociateConfig()
    fuse: FuseConfig = FuseConfig()
    output: OutputConfig = OutputConfig()
    run: RunConfig = RunConfig()
    limits: LimitsConfig = LimitsConfig()
    classes: Annotated[tuple[ClassPrior, ...], Field(min_length=1)] = _ROAD_CLASSES

    @model_validator(mode="after")
    def _names_are_unique(self) -> "Config":
        names = [prior.name for prior in self.classes]
        if len(set(names)) < len(names):
            raise ValueError(f"classes: a name stands twice in {', '.join(names)}")
        return self

    @property
    def class_names(self) -> tuple[str, ...]:
        """Names by class id."""
        return tuple(prior.name for prior in self.classes)

    @property
    def class_id_of_label(self) -> dict[str, int]:
        """Class id by each name that a 2D detector may use, the class's own name included."""
        return {label: class_id for class_id, prior in enumerate(self.classes) for label in (prior.name, *prior.labels)}


def load_config(path: Path | None = None, overrides: tuple[str, ...] = ()) -> Config:
    """Defaults, then a YAML file, then single values `a.b=value` (the value is YAML).

    Raises:
        ConfigError: the file cannot be read, a key is unknown, or a value does not fit.
    """
    tree: dict[str, Any] = {}
    if path is not None:
        tree = read_yaml(path)
    set_values(tree, overrides)
    try:
        return Config.model_validate(tree)
    except ValidationError as err:
        raise ConfigError(f"{path or 'settings'}: {describe_validation(Config, err)}") from err


def set_values(tree: dict[str, Any], overrides: tuple[str, ...]) -> None:
    """Put single values `a.b=value` (the value is YAML) into a tree of settings.

    Raises:
        ConfigError: one is not of this form, or leads through a value.
    """
    for override in overrides:
        key, separator, text = override.partition("=")
        if not separator or not key:
            raise ConfigError(f"--set {override}: expected key.key=value")
        try:
            value = parse_yaml(text)
        except yaml.YAMLError as err:
            raise ConfigError(f"--set {override}: the value is not YAML") from err
        *parents, leaf = key.split(".")
        branch = tree
        for parent in parents:
            nested = branch.setdefault(parent, {})
            if not isinstance(nested, dict):
                raise ConfigError(f"--set {override}: {parent!r} is a value, not a section")
            branch = nested
        branch[leaf] = value


def dump_config(config: Config) -> str:
    """All settings as YAML that `load_config` reads back; `config/default.yaml` is `dump_config(Config())`."""
    text: str = yaml.safe_dump(config.model_dump(mode="json"), sort_keys=False, default_flow_style=None, width=100)
    return text


def describe_validation(model: type[BaseModel], err: ValidationError) -> str:
    """The first fault of a validation in one line, with the keys that would have been right."""
    fault = err.errors()[0]
    key = ".".join(str(part) for part in fault["loc"])
    more = f" (and {err.error_count() - 1} more)" if err.error_count() > 1 else ""
    if fault["type"] == "extra_forbidden":
        return f"unknown key {key!r}{more}; known here: {', '.join(_known_keys(model, fault['loc']))}"
    if fault["type"] == "value_error" and not key:  # of several keys together: the message names them
        return f"{fault['ctx']['error']}{more}"
    found = repr(fault.get("input"))
    return f"{key}: {fault['msg']}, found {found if len(found) <= 200 else found[:200] + '...'}{more}"


def _known_keys(model: type[BaseModel], location: tuple[int | str, ...]) -> list[str]:
    """Keys of the section that holds the last part of `location`."""
    for part in location[:-1]:
        if isinstance(part, str) and part in model.model_fields:
            nested = _model_in(model.model_fields[part].annotation)
            if nested is not None:
                model = nested
    return list(model.model_fields)


def _model_in(annotation: Any) -> type[BaseModel] | None:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    return next((model for part in get_args(annotation) if (model := _model_in(part)) is not None), None)


class _Loader(yaml.SafeLoader):
    def fetch_flow_collection_start(self, TokenClass: Any) -> None:
        if self.flow_level == MOST_YAML_BRACKETS:
            raise yaml.YAMLError(f"more than {MOST_YAML_BRACKETS} brackets in one another")
        super().fetch_flow_collection_start(TokenClass)


def parse_yaml(text: str | bytes) -> Any:
    """What `yaml.safe_load` gives, of a file that holds a bounded number of values.

    Raises:
        yaml.YAMLError: it is no YAML, too large, or nested too deeply.
    """
    if len(text) > MOST_YAML_BYTES:
        raise yaml.YAMLError(f"more than {MOST_YAML_BYTES >> 20} MiB")
    loader = _Loader(text)
    try:
        node = loader.get_single_node()
        if node is None:
            return None
        _count_values(node, {})
        return loader.construct_document(node)
    except RecursionError as err:
        raise yaml.YAMLError("nested too deeply") from err
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as err:  # of dates and long numbers
        raise yaml.YAMLError(f"a value that is none: {err}") from err
    finally:
        loader.dispose()


def _count_values(node: yaml.Node, counts: dict[int, int]) -> int:
    """Values that a node stands for; those of aliases are counted once and added each time."""
    if id(node) in counts:
        if not counts[id(node)]:
            raise yaml.YAMLError("a value that contains itself")
        return counts[id(node)]
    counts[id(node)] = 0
    parts: list[yaml.Node] = []
    if isinstance(node, yaml.SequenceNode):
        parts = node.value
    elif isinstance(node, yaml.MappingNode):
        parts = [part for pair in node.value for part in pair]
    counts[id(node)] = total = 1 + sum(_count_values(part, counts) for part in parts)
    if total > MOST_YAML_VALUES:
        raise yaml.YAMLError(f"more than {MOST_YAML_VALUES} values")
    return total


def read_yaml(path: Path) -> dict[str, Any]:
    """A YAML file that holds a mapping.

    Raises:
        ConfigError: the file cannot be read, is not YAML, or holds something else.
    """
    try:
        with path.open(encoding="utf-8") as stream:
            tree = parse_yaml(stream.read(MOST_YAML_BYTES + 1))
    except (OSError, UnicodeDecodeError) as err:
        raise ConfigError(f"{path}: cannot be read: {err}") from err
    except yaml.YAMLError as err:
        raise ConfigError(f"{path}: not YAML: {' '.join(str(err).split())}") from err
    if tree is None:
        return {}
    if not isinstance(tree, dict):
        raise ConfigError(f"{path}: expected a mapping of sections, found {type(tree).__name__}")
    return tree
