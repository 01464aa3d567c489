"""The input and the outcome of an evaluation."""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lidcam.evaluation.figures import NamedFigures
from lidcam.evaluation.requirement import Outcome, Requirement, read_requirements
from lidcam.pipeline.core.errors import CalibrationError
from lidcam.readers.input_file import InputFile
from lidcam.readers.location import Location
from lidcam.readers.rig.schema import RigFile
from lidcam.run.effect import check_effect
from lidcam.run.job import FilePath, PathOrUrl, RigSource, Settings, locations, read_rig
from lidcam.run.warning import RunWarning


@dataclass(frozen=True, slots=True)
class EvaluationJob:
    """A result, and the truth to compare it with."""

    result: Path  # The .mcap file that `lidcam process` wrote
    truth: tuple[Location, ...] = ()  # Recordings or files of labels; empty: the truth in the result
    truth_topic: str = ""  # Topic of the truth; empty: found by name
    rig: RigFile | None = None  # Rig file whose zones and truth vehicles replace those of the result
    settings: Sequence[str] = ()  # Single settings on top of those of the result
    requirements: tuple[Requirement, ...] = ()  # Limits that the figures must meet
    labelled: str = ""  # To which part the settings limit it because truth is labelled there alone, in words


def make_evaluation_job(
    result: FilePath,
    *,
    truth: PathOrUrl | Sequence[PathOrUrl] = (),
    truth_topic: str = "",
    requirements: str | Requirement | Sequence[str | Requirement] = (),
    rig: RigSource | None = None,
    settings: Settings = (),
) -> EvaluationJob:
    """An evaluation, with its rig file, its settings and its requirements read; arguments as of `lidcam.evaluate`.

    Raises RequirementError if a requirement is malformed, and LidcamError if a file cannot be read or does not fit.
    """
    required = [requirements] if isinstance(requirements, str | Requirement) else [*requirements]
    texts = [one for one in required if isinstance(one, str)]
    given = tuple(as_texts(settings))
    check_effect(given)
    rig_file = read_rig(rig)
    if rig_file is not None and not rig_file.vehicles and rig_file.zones is None:
        raise CalibrationError(
            "rig: expected `truth` or `zones` in the rig file of an evaluation, found neither; sensors and calibration "
            "are those of the result: process with the rig to change them"
        )
    return EvaluationJob(
        Path(result),
        locations(truth),
        truth_topic,
        rig_file,
        given,
        (*(one for one in required if isinstance(one, Requirement)), *read_requirements(texts)),
    )


def as_texts(settings: Settings) -> Iterator[str]:
    """Single settings as the command line takes them, `a.b=c`."""
    if isinstance(settings, Mapping):
        for key, value in settings.items():
            yield f"{key}={json.dumps(value)}"  # JSON is YAML
    else:
        yield from [settings] if isinstance(settings, str) else settings


@dataclass(frozen=True, slots=True)
class Truth:
    """The truth that figures compare with."""

    source: str  # Where it was taken from, in words
    inputs: tuple[InputFile, ...]  # The files that it stands in
    labelled: str = ""  # Where alone it is labelled, in words, if that limits the evaluation

    def tree(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        files = [file.tree() for file in self.inputs]
        return {"from": [self.source], "inputs": files, "labelled": self.labelled or None}

    def __str__(self) -> str:
        """The source, and the only part in which it is labelled."""
        part = f", labelled only {self.labelled} (evaluate.region=everywhere counts all)" if self.labelled else ""
        return f"{self.source}{part}"


@dataclass(frozen=True, slots=True)
class Evaluation:
    """The outcome of an evaluation. Holds no open file: it can be pickled.

    Attributes:
        figures: All figures by name: `evaluation.figures["fused.car.recall"]`.
        inputs: The result.
        settings_name: Name of the settings in the result.
        settings_sha256: Checksum of the settings of the evaluation.
        truth: The truth that the figures compare with; None without truth.
        outcomes: The outcome of each requirement.
        warnings: Reasons to doubt the figures.
        notes: Remarks on the result and the truth.
        incomplete: Parts of the result that could not be used.
    """

    figures: NamedFigures
    inputs: tuple[InputFile, ...]
    settings_name: str
    settings_sha256: str
    truth: Truth | None
    outcomes: tuple[Outcome, ...] = ()
    warnings: tuple[RunWarning, ...] = ()
    notes: tuple[str, ...] = ()
    incomplete: tuple[str, ...] = ()

    @property
    def failures(self) -> tuple[str, ...]:
        """Requirements that are not met, a line each."""
        return tuple(outcome.failure for outcome in self.outcomes if outcome.failure)

    def tree(self) -> dict[str, Any]:
        """The figures and the requirements, as plain values, for JSON."""
        return {**self.figures.tree, "requirements": [outcome.tree() for outcome in self.outcomes]}
