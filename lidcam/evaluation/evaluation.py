"""What an evaluation takes and gives."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lidcam.checks.warning import RunWarning
from lidcam.evaluation.figures import NamedFigures
from lidcam.evaluation.requirement import Outcome, Requirement
from readers.input_file import InputFile
from readers.location import Location
from readers.rig.schema import RigFile

__all__ = ["Evaluation", "EvaluationJob", "Truth"]


@dataclass(frozen=True, slots=True)
class EvaluationJob:
    """What to evaluate, and against what.

    Attributes:
        result: The .mcap file that `lidcam process` wrote.
        truth: Recordings or files of labels; empty: what the result holds.
        truth_topics: Topics of truth; empty: those that are truth by their names.
        rig: Rig file with topics of truth.
        settings: Single settings on top of those of the result.
        requirements: What is required of the figures.
    """

    result: Path
    truth: tuple[Location, ...] = ()
    truth_topics: tuple[str, ...] = ()
    rig: RigFile | None = None
    settings: Sequence[str] = ()
    requirements: tuple[Requirement, ...] = ()


@dataclass(frozen=True, slots=True)
class Truth:
    """What figures compare with.

    Attributes:
        sources: Each place that it was taken from, in words.
        inputs: The files that it stands in.
    """

    sources: tuple[str, ...]
    inputs: tuple[InputFile, ...]

    def tree(self) -> dict[str, Any]:
        """As plain values, for JSON."""
        return {"from": list(self.sources), "inputs": [file.tree() for file in self.inputs]}


@dataclass(frozen=True, slots=True)
class Evaluation:
    """What comes of an evaluation. Holds no open file: it can be pickled.

    Attributes:
        figures: All figures by name: `evaluation.figures["fused.car.recall"]`.
        inputs: The result.
        settings_name: What the result says of its settings.
        settings_sha256: Checksum of the settings of the evaluation.
        truth: What the figures compare with; None without truth.
        outcomes: What comes of the requirements.
        warnings: What makes the figures doubtful.
        notes: Remarks on the result and the truth.
        incomplete: What of the result could not be used.
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
        """The figures and what was required of them, as plain values, for JSON."""
        return {**self.figures.tree, "requirements": [outcome.tree() for outcome in self.outcomes]}
