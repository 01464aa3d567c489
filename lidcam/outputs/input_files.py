"""The files that a result says it is of: the recording, and those that the settings name."""

from collections.abc import Mapping

from lidcam.readers.input_file import InputFile, InputFiles, read_input_file
from lidcam.run.box_sources import box_source, network_3d
from lidcam.run.effect import named_files
from lidcam.run.frames import RunInput
from lidcam.run.job import Job


def read_named_files(job: Job) -> dict[str, InputFile]:
    """The files that the settings of a job name, with checksums, by their names in the metadata of a result.

    Raises:
        RecordingError: one cannot be read.
    """
    return {key: read_input_file(path) for key, path in named_files(job.config).items()}


def input_files(source: RunInput, named: Mapping[str, InputFile], *, is_written: bool) -> InputFiles:
    """The files of an open recording and those of the detectors that find its boxes.

    The recording gets checksums if results say what they are of, but not where a part of it is processed: to read the
    rest as well takes minutes where it is large.

    Args:
        source: The open recording.
        named: What `read_named_files` found.
        is_written: Whether there will be results.

    Raises:
        RecordingError: a network cannot be read.
    """
    recording, window = source.recording, source.window
    is_whole = window.start_ns is None and (window.stop_ns is None or window.stop_ns > recording.end_ns)
    if box_source(source.config, source.rig) != "onnx":
        named = {key: file for key, file in named.items() if not key.startswith("network")}
    model = network_3d(source.config)
    if model and "detect3d.model" not in named:
        named = {**named, "detect3d.model": read_input_file(model)}  # what comes with lidcam, chosen by the recording
    return InputFiles(recording.opened, named, with_checksums=is_written and is_whole)
