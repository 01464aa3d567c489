"""The origin of a result: its input files, its settings, and the summary of its run."""

import json
from collections.abc import Callable, Mapping
from dataclasses import asdict
from importlib.metadata import version
from typing import Any

from lidcam.readers.input_file import InputFile, InputFiles, read_input_file
from lidcam.readers.rig.rig_file import rig_yaml
from lidcam.run.box_sources import box_source, network_3d
from lidcam.run.effect import lasting_settings
from lidcam.run.frames import RunInput
from lidcam.run.job import Job
from lidcam.run.summary import RunSummary, summary_tree
from lidcam.writers.provenance import Provenance

MAX_LISTED = 20
"""Damaged parts in the attached summary, which says how many more there are."""


def input_files(source: RunInput, named: Mapping[str, InputFile], *, is_written: bool) -> InputFiles:
    """The files of an open recording and those of the detectors that find its boxes.

    The recording gets checksums if there will be results, unless only a part of it is processed: reading the rest takes
    minutes where it is large.
    """
    recording, window = source.recording, source.window
    is_whole = window.start_ns is None and (window.stop_ns is None or window.stop_ns > recording.end_ns)
    if box_source(source.config, source.rig) != "onnx":
        named = {key: file for key, file in named.items() if not key.startswith("network")}
    model = network_3d(source.config)
    if model and "detect3d.model" not in named:
        named = {**named, "detect3d.model": read_input_file(model)}  # what comes with lidcam, chosen by the recording
    return InputFiles(recording.opened, named, with_checksums=is_written and is_whole)


def provenance_of(job: Job, source: RunInput, inputs: InputFiles, summary: Callable[[], RunSummary]) -> Provenance:
    """The origin of the results of a job; `summary` gives that of the run, at its end."""
    named = {f"{key}.name": file.name for key, file in inputs.named.items()}
    named |= {f"{key}.name": name for key, name in job.given.names.items()}
    if "network" in inputs.named:
        named["network.provider"] = source.config.detect2d.provider

    def checksums() -> dict[str, str]:
        files = {f"input.{row}": file for row, file in enumerate(inputs.finish())} | dict(inputs.named)
        return {f"{key}.{fact}": value for key, file in files.items() for fact, value in file.as_read.items()}

    return Provenance(
        version=version("lidcam"),
        inputs=tuple(file.provenance for file in inputs.unread),
        fingerprint=inputs.fingerprint,
        checksums=checksums,
        settings=str(source.settings),
        config_yaml=lasting_settings(source.config),
        rig_yaml=rig_yaml(source.rig),
        start_ns=source.recording.start_ns,
        boxes3d_topics=tuple(detector.topic for detector in source.rig.detectors),
        named=named,
        summary=lambda: summary_text(summary(), job),
    )


def summary_text(summary: RunSummary, job: Job) -> str:
    """The summary of a run as JSON, without times of the clock and folders of this machine.

    Keys are those of `summary_tree` and `warnings`, `notes`, `incomplete`, `calibration`.
    """
    tree = summary_tree(summary)
    for key in ("timing", "outputs", "road_users"):  # the clock's, this machine's; and what the result itself has
        del tree[key]
    losses = tree.pop("losses")
    tree |= {
        "losses": losses[:MAX_LISTED],
        "losses_more": max(len(losses) - MAX_LISTED, 0),
        "warnings": [asdict(warning) for warning in summary.warnings],
        "notes": list(summary.notes),
        "incomplete": list(summary.incomplete),
        "calibration": [asdict(source) for source in summary.sensors.calibration],
    }
    names = {str(path): path.name for path in (*job.inputs, *job.read_files)}
    return json.dumps(_without_folders(tree, names), indent=1, ensure_ascii=False)


def _without_folders(value: Any, names: dict[str, str]) -> Any:
    """A tree with names of files in place of their paths."""
    if isinstance(value, str):
        for path in sorted(names, key=len, reverse=True):
            value = value.replace(path, names[path])
        return value
    if isinstance(value, dict):
        return {_without_folders(key, names): _without_folders(one, names) for key, one in value.items()}
    return [_without_folders(one, names) for one in value] if isinstance(value, list) else value
