"""The comparison of two results."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lidcam.evaluation.allowed import AllowedDifference
from lidcam.evaluation.evaluate import Advance, Progress, not_shown
from lidcam.evaluation.figures import NamedFigures
from lidcam.pipeline.core.errors import ConfigError, LidcamError
from lidcam.pipeline.evaluation.comparison.comparison import Comparison, FramePair, paired_frames
from lidcam.pipeline.evaluation.comparison.differences import Channel
from lidcam.pipeline.evaluation.comparison.object_changes import KINDS
from lidcam.readers.input_file import InputFile, read_opened_files, recorded_inputs
from lidcam.readers.results.result import Result, open_result
from lidcam.run.missing import changed_lines, damage_lines


@dataclass(frozen=True, slots=True)
class ComparedResults:
    """Differences of two results, A and B. Holds no open file: it can be pickled.

    Attributes:
        figures: The counts of frames and objects, by source, camera and class, and the largest differences of each kind
            (`figures.tree["differences"]`).
        failures: The sources and cameras that differ more than is allowed, a line each; empty: none.
        inputs: The two results.
        notes: Remarks on the results.
        incomplete: Parts of the results that could not be read.
    """

    figures: NamedFigures
    failures: tuple[str, ...]
    inputs: tuple[InputFile, ...]
    notes: tuple[str, ...] = ()
    incomplete: tuple[str, ...] = ()

    @property
    def is_equal(self) -> bool:
        """Whether nothing differs by more than the tolerances."""
        figures = self.figures
        return not any((figures["differences.count"], figures["frames_only_in_a"], figures["frames_only_in_b"]))


def compare_results(
    first: Path,
    second: Path,
    *,
    only: str | Sequence[str] = (),
    allow: str | Sequence[str] = (),
    max_different_percent: float = 0.0,
    show: Progress = not_shown,
) -> ComparedResults:
    """Compare two results, object by object; arguments and errors as of `lidcam.compare`."""
    only, allow = ([names] if isinstance(names, str) else names for names in (only, allow))
    if not 0 <= max_different_percent <= 100:
        raise ConfigError(f"max_different_percent: expected 0 to 100, found {max_different_percent:g}")
    if unknown := [one for one in allow if one not in [*AllowedDifference]]:
        raise ConfigError(f"allow: expected {', '.join(AllowedDifference)}, found {unknown[0]!r}")
    with open_result(first) as one, open_result(second) as other:
        comparison = _comparison(one, other, only, allow)
        start_ns = min(one.recording.start_ns, other.recording.start_ns)
        end_ns = max(one.recording.end_ns, other.recording.end_ns)
        with show((end_ns - start_ns) / 1e9) as advance:
            for pair in _pairs(one, other, start_ns, advance):
                comparison.add_pair(pair)
        comparison.close()
        losses = *one.recording.losses, *other.recording.losses
        notes = (*_recordings_note(one, other), *one.notes, *other.notes)
        files = read_opened_files((*one.recording.opened, *other.recording.opened))
    changed = changed_lines(file.path for file in files if file.is_changed)
    return ComparedResults(
        figures=NamedFigures(comparison.figures()),
        failures=_failures(comparison, allow, max_different_percent),
        inputs=files,
        notes=notes,
        incomplete=(*damage_lines(losses), *changed),
    )


def _comparison(first: Result, second: Result, only: Sequence[str], allowed: Sequence[str]) -> Comparison:
    """A comparison of the sources and cameras that are asked for, if the results have those and are of one site."""
    frames = first.rig.site_frame, second.rig.site_frame
    if frames[0] != frames[1]:
        raise LidcamError(
            f"{second.path}: expected objects in the frame of {first.path}, {frames[0]!r}, found {frames[1]!r}; "
            "compare results of one site"
        )
    channels: list[Channel] = [("sources", name) for name in dict.fromkeys((*first.sources, *second.sources))]
    channels += [("images", name) for name in dict.fromkeys((*first.cameras, *second.cameras))]
    known = [name for _, name in channels]
    if unknown := [name for name in only if name not in known]:
        raise LidcamError(f"only: expected one of {', '.join(known)}, which the results have, found {unknown[0]!r}")
    chosen = [channel for channel in channels if not only or channel[1] in only]
    kinds = [kind for kind in KINDS if kind in allowed]
    return Comparison(first.config.classes, second.config.classes, chosen, kinds)


def _recordings_note(first: Result, second: Result) -> Iterator[str]:
    """A note if the results are of two recordings; only facts that both results hold of theirs are compared."""
    names, checksums, sizes = (
        [[one[fact] for one in recorded_inputs(result.metadata) if fact in one] for result in (first, second)]
        for fact in ("name", "sha256", "size")
    )
    facts = [checksums] if all(checksums) else [names, sizes]
    if any(a and b and a != b for a, b in facts):
        yield f"A and B are results of different recordings: {', '.join(names[0])}, {', '.join(names[1])}"


def _pairs(first: Result, second: Result, start_ns: int, advance: Advance) -> Iterator[FramePair]:
    for number, pair in enumerate(paired_frames(first.frames(), second.frames())):
        yield pair
        log_time_ns = max(frame.log_time_ns for frame in pair if frame is not None)
        advance((log_time_ns - start_ns) / 1e9, f"{number + 1} frames")


def _failures(comparison: Comparison, allowed: Sequence[str], max_different_percent: float) -> tuple[str, ...]:
    """Lines about each source or camera with more differences than allowed."""
    frames = AllowedDifference.frames
    found: Mapping[str, Any] = comparison.not_allowed_percent(frames_may_differ=frames in allowed)
    kinds = [kind for kind in AllowedDifference if kind in allowed and kind != frames]
    but = f" but for what is {', '.join(kinds)}" if kinds else ""
    return tuple(
        f"{name}: expected at most {max_different_percent:g} % "
        + ("in one result alone" if name == frames else f"of the objects to differ{but}")
        + f", found {percent:.3g} %"
        for name, percent in found.items()
        if percent > max_different_percent
    )
