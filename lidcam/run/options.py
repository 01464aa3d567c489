"""The options of a job, each declared once: keywords of `lidcam.process`, and options of the commands that run jobs."""

import inspect
import re
from collections.abc import Callable
from textwrap import fill
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple, TypedDict, TypeVar

if TYPE_CHECKING:  # `lidcam --help` does without
    from collections.abc import Mapping, Sequence
    from os import PathLike

    from lidcam.pipeline.core.settings.config import Config
    from lidcam.pipeline.detectors.given import FindInCloud, FindInImage
    from lidcam.readers.rig.schema import RigFile

    FilePath = str | PathLike[str]
    RigSource = RigFile | FilePath | Sequence[RigFile | FilePath]

OnBadMessage = Literal["skip", "fail"]
Device = Literal["auto", "cpu", "cuda"]

F = TypeVar("F", bound=Callable[..., Any])


class CliOption(NamedTuple):
    """The command-line form of an option of a job."""

    type: Any  # That it is parsed to; the value of an option that is not given is None, of a switch False
    name: str
    metavar: str | None = None
    minimum: float | None = None
    group: str = "Run"  # The heading that the help lists it under


class SharedOptions(TypedDict, total=False):
    """Options of a job that a batch has for all of its jobs, too; all have a default.

    Attributes:
        config: Settings: a preset (sandbox, crossing, road) or a YAML file. Default: chosen from the recording.
        settings: Settings by key; they override the configuration.
        rig: Sensors, calibration and zones: a rig file, a preset (original), or a calibration file of KITTI, Kalibr,
            Autoware or ROS. Later files add and replace. Default: as recorded.
        model_2d: 2D network: an ONNX file, or a name that `lidcam fetch` knows; none: without. Default: auto, a fetched
            network if the recording has images without 2D boxes.
        model_3d: 3D network: an ONNX file, traffic (the default for full-size road users) or sandbox.
        device: Device that runs 2D and 3D networks; auto: CUDA if it is available. CUDA results differ in the last
            digits. Default: the settings detect2d.provider and detect3d.provider, cpu.
        start_s: Skip the first S seconds.
        duration_s: Process S seconds. Default: to the end.
        every: Process every Nth frame only.
        workers: Worker processes; does not change the result. Default: run.workers of the settings, else one per core.
        on_bad_message: Skip and count messages that cannot be decoded and damaged parts of files, or fail at the first.
            Default: skip.
        copy_topics: Topics to copy to the output, e.g. /map or '/radar/*'. Default: ground-truth topics.
    """

    config: Annotated["Config | FilePath | None", CliOption(str, "--config", "PRESET|FILE", group="Inputs")]
    settings: Annotated["Mapping[str, object] | Sequence[str]", CliOption(list[str], "--set", "A.B=C", group="Inputs")]
    rig: Annotated["RigSource | None", CliOption(list[str], "--rig", "FILE", group="Sensors")]
    model_2d: Annotated["FilePath | None", CliOption(str, "--model-2d", "FILE.onnx|NAME|none", group="Networks")]
    model_3d: Annotated["FilePath | None", CliOption(str, "--model-3d", "FILE.onnx|NAME", group="Networks")]
    device: Annotated[Device | None, CliOption(Device, "--device", group="Networks")]
    start_s: Annotated[float, CliOption(float, "--start", "S", 0, group="Inputs")]
    duration_s: Annotated[float | None, CliOption(float, "--duration", "S", group="Inputs")]
    every: Annotated[int | None, CliOption(int, "--every", "N", 1, group="Inputs")]
    workers: Annotated[int | None, CliOption(int, "--workers", "N", 1)]
    on_bad_message: Annotated[OnBadMessage, CliOption(OnBadMessage, "--on-bad-message", group="Inputs")]
    copy_topics: Annotated["Sequence[str] | None", CliOption(list[str], "--copy-topics", "PATTERN", group="Outputs")]


class JobOptions(SharedOptions, total=False):
    """Options of a job, all with a default, beside those that it shares with a batch.

    Attributes:
        overwrite: Overwrite files that lidcam did not write (never inputs).
        view: Show the frames in the Rerun viewer during the run.
        foxglove: Serve the frames to Foxglove during the run. Without a host, only this machine can connect: its
            programs, and any web page in its browser.
        pace: Limit playback to N x real time, e.g. 1. Default: as fast as possible.
        save_matches: Also write a JPEG of each camera and frame into this folder, with 2D and 3D boxes and matches.
        detector: Function that finds boxes in a cloud, in place of lidcam's: it takes an (N, 4) float32 array of x, y,
            z (m, site frame) and intensity, with the ground, and returns a `Found3D`. What it returns may depend on its
            argument alone.
        detector_2d: Function that finds boxes in an image, in place of lidcam's: it takes an (H, W, 3) uint8 RGB array
            and returns a `Found2D`. What it returns may depend on its argument alone.
    """

    overwrite: Annotated[bool, CliOption(bool, "--overwrite", group="Outputs")]
    view: Annotated[bool, CliOption(bool, "--view")]
    foxglove: Annotated[int | str | None, CliOption(str, "--foxglove", "[HOST:]PORT")]
    pace: Annotated[float | None, CliOption(float, "--pace", "N")]
    save_matches: Annotated["FilePath | None", CliOption(str, "--save-matches", "DIR", group="Outputs")]
    detector: "FindInCloud | None"
    detector_2d: "FindInImage | None"


def attribute_docs(owner: type) -> dict[str, str]:
    """The explanations in the section `Attributes` of the docstring of a class, by the name of the attribute."""
    text = inspect.cleandoc(owner.__doc__ or "").partition("Attributes:")[2]
    found = re.findall(r"^    (\w+): (.*(?:\n {8}.*)*)", text, re.MULTILINE)
    return {name: " ".join(words.split()) for name, words in found}


OPTION_DOCS = attribute_docs(SharedOptions) | attribute_docs(JobOptions)
"""The explanation of each option."""

DEFAULTS: JobOptions = {"settings": (), "start_s": 0.0, "on_bad_message": "skip", "overwrite": False, "view": False}
"""Values of options that are not given, where it is not None."""

CLI_OPTIONS = tuple(name for name, kind in JobOptions.__annotations__.items() if hasattr(kind, "__metadata__"))
"""Those that the command line has."""


def with_job_keywords(*names: str) -> Callable[[F], F]:
    """A decorator of functions that take `**options` of a job: `help` and completion show each of the named ones.

    Type checkers know them by the `Unpack` of the annotation; the signature and the docstring that Python shows are
    made here.
    """

    def decorated(function: F) -> F:
        signature = inspect.signature(function)
        own = [one for one in signature.parameters.values() if one.kind != inspect.Parameter.VAR_KEYWORD]
        added = [
            inspect.Parameter(
                name, inspect.Parameter.KEYWORD_ONLY, default=DEFAULTS.get(name), annotation=_type_text(name)
            )
            for name in names
        ]
        vars(function)["__signature__"] = signature.replace(parameters=[*own, *added])
        first, later = " " * 8, " " * 12
        texts = [f"{name}: {OPTION_DOCS[name]}" for name in names]
        lines = "\n".join(fill(text, 120, initial_indent=first, subsequent_indent=later) for text in texts)
        function.__doc__ = re.sub(r" {8}\*\*options: .*(\n {12}.*)*", lambda _: lines, function.__doc__ or "")
        return function

    return decorated


def _type_text(name: str) -> Any:
    kind = JobOptions.__annotations__[name]
    kind = getattr(kind, "__origin__", kind) if hasattr(kind, "__metadata__") else kind
    return getattr(kind, "__forward_arg__", kind)
