"""The options of a job, each declared once: keywords of `lidcam.process`, and options of the commands that run jobs."""

import inspect
import re
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple, TypedDict

if TYPE_CHECKING:  # `lidcam --help` does without
    from collections.abc import Mapping, Sequence
    from os import PathLike

    from lidcam.pipeline.core.settings.config import Config
    from lidcam.readers.rig.schema import RigFile

    FilePath = str | PathLike[str]
    RigSource = RigFile | FilePath | Sequence[RigFile | FilePath]

OnBadMessage = Literal["skip", "fail"]
Device = Literal["auto", "cpu", "cuda"]


class CliOption(NamedTuple):
    """The command-line form of an option of a job.

    Attributes:
        type: The type that it is parsed to; the value of an option that is not given is None, of a switch False.
        name: The name of the option.
        metavar: The placeholder of its value in the help.
        minimum: The smallest allowed number.
    """

    type: Any
    name: str
    metavar: str | None = None
    minimum: float | None = None


class JobOptions(TypedDict, total=False):
    """Options of a job, all with a default.

    Attributes:
        config: Settings: a preset (sandbox, crossing, road) or a YAML file. Default: chosen from the recording.
        settings: Single settings by key, overriding the others.
        rig: Sensors, calibration and zones: a rig file, a preset (original), or a calibration file of KITTI, Kalibr or
            Autoware. Later files add and replace. Default: as recorded.
        model_2d: 2D network: an ONNX file, or a name that `lidcam fetch` knows; none: without. Default: auto, a fetched
            network if the recording has images without 2D boxes.
        model_3d: 3D network: an ONNX file, traffic (the default for full-size road users) or sandbox.
        device: Device that runs 2D and 3D networks; auto: cuda where it can be used. Results of cuda differ in the last
            digits. Default: cpu, or the settings detect2d.provider and detect3d.provider.
        start_s: Skip the first S seconds.
        duration_s: Process S seconds. Default: to the end.
        every: Process every Nth frame only.
        workers: Worker processes; does not change the result. Default: run.workers of the settings, else one per core.
        on_bad_message: Skip and count messages that cannot be decoded and damaged parts of files, or fail at the first.
            Default: skip.
        copy_topics: Topics to copy to the output, e.g. /map or '/radar/*'. Default: ground-truth topics.
        overwrite: Overwrite files that lidcam did not write (never inputs).
        view: Show the frames in the Rerun viewer during the run.
        foxglove: Serve the frames to Foxglove during the run. Without a host, only this machine can connect: its
            programs, and any web page in its browser.
        pace: Limit playback to N x real time, e.g. 1. Default: as fast as possible.
        save_matches: Also write an image (JPEG) of each camera and frame into this folder: 2D and 3D boxes, matches.
    """

    config: Annotated["Config | FilePath | None", CliOption(str, "--config", "PRESET|FILE")]
    settings: Annotated["Mapping[str, object] | Sequence[str]", CliOption(list[str], "--set", "A.B=C")]
    rig: Annotated["RigSource | None", CliOption(list[str], "--rig", "FILE")]
    model_2d: Annotated["FilePath | None", CliOption(str, "--model-2d", "FILE.onnx|NAME|none")]
    model_3d: Annotated["FilePath | None", CliOption(str, "--model-3d", "FILE.onnx|NAME")]
    device: Annotated[Device | None, CliOption(Device, "--device")]
    start_s: Annotated[float, CliOption(float, "--start", "S", 0)]
    duration_s: Annotated[float | None, CliOption(float, "--duration", "S", 0)]
    every: Annotated[int | None, CliOption(int, "--every", "N", 1)]
    workers: Annotated[int | None, CliOption(int, "--workers", "N", 1)]
    on_bad_message: Annotated[OnBadMessage, CliOption(OnBadMessage, "--on-bad-message")]
    copy_topics: Annotated["Sequence[str] | None", CliOption(list[str], "--copy-topics", "PATTERN")]
    overwrite: Annotated[bool, CliOption(bool, "--overwrite")]
    view: Annotated[bool, CliOption(bool, "--view")]
    foxglove: Annotated[int | str | None, CliOption(str, "--foxglove", "[HOST:]PORT")]
    pace: Annotated[float | None, CliOption(float, "--pace", "N")]
    save_matches: Annotated["FilePath | None", CliOption(str, "--save-matches", "DIR")]


def attribute_docs(owner: type) -> dict[str, str]:
    """The explanations in the section `Attributes` of the docstring of a class, by the name of the attribute."""
    text = inspect.cleandoc(owner.__doc__ or "").partition("Attributes:")[2]
    found = re.findall(r"^    (\w+): (.*(?:\n {8}.*)*)", text, re.MULTILINE)
    return {name: " ".join(words.split()) for name, words in found}
