"""The end of a command that has done its work: complete, incomplete, or short of a check."""

from collections import Counter
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

from lidcam.pipeline.core.errors import CheckError, IncompleteError

if TYPE_CHECKING:
    from lidcam.run.summary import RunSummary

DONE, FAILED, INCOMPLETE = 0, 1, 3
"""Exit codes: done; failed, or a check failed; done, but part of the recording could not be used."""

MAX_LISTED = 4
"""Reasons in the line."""

MAX_MISSING_PERCENT = 5.0
"""Share of a topic's messages that may be dropped, and of the frames in which a sensor may be silent."""

MAX_MISSING = 2
"""Messages and frames that may be missing however short a recording is: one at either end may have no partners."""


class Verdict(NamedTuple):
    """The end of a command that has done its work."""

    failures: tuple[str, ...] = ()  # Failed checks, one line each; the outputs are kept
    incomplete: Sequence[str] = ()  # Parts of the recording that could not be used, one line each

    @property
    def exit_code(self) -> int:
        """The exit code of the program."""
        return FAILED if self.failures else INCOMPLETE if self.incomplete else DONE

    def tree(self) -> dict[str, Any]:
        """The verdict as plain values, for JSON."""
        return {"failure": "; ".join(self.failures), "incomplete": [*self.incomplete], "exit_code": self.exit_code}

    def end(self) -> None:
        """End the command."""
        if self.failures:
            raise CheckError(*self.failures)
        if self.incomplete:
            raise IncompleteError(first_of(self.incomplete))


def first_of(reasons: Sequence[str]) -> str:
    """The first reasons in one line, and how many more there are."""
    more = f"; and {len(reasons) - MAX_LISTED} more" if len(reasons) > MAX_LISTED else ""
    return f"{'; '.join(reasons[:MAX_LISTED])}{more}"


def strict_failure(summary: "RunSummary") -> str:
    """One line about what was left out, silent, dropped or damaged beyond the limits; empty if nothing was."""
    damaged = Counter(str(loss.path) for loss in summary.inputs.losses)
    findings = [
        *(f"{fault.subject} is left out: {fault.reason}" for fault in summary.sensors.faults),
        *_silent(summary),
        *_dropped(summary),
        *(f"{path}: {count} damaged part{'s' * (count > 1)}" for path, count in sorted(damaged.items())),
    ]
    return f"--strict: {first_of(findings)}; the outputs are complete" if findings else ""


def _silent(summary: "RunSummary") -> list[str]:
    """Sensors that fell silent; not those that are missing from frames because they are slower than others."""
    findings = []
    for sensor in summary.sensors.missing:
        frames = sum(span.frames for span in sensor.silences)
        if 100 * frames > MAX_MISSING_PERCENT * sensor.of_frames and frames > MAX_MISSING:
            findings.append(f"{sensor.sensor}: {sensor.spans}, {frames} of {sensor.of_frames} frames lack it")
    return findings


def _dropped(summary: "RunSummary") -> list[str]:
    from lidcam.run.frames import NOT_EVERY

    dropped: Counter[str] = Counter()
    for drop in summary.drops.messages:
        if drop.unit == "messages" and drop.reason != NOT_EVERY:
            dropped[drop.topic] += drop.count
    findings = []
    for topic, count in sorted(dropped.items()):
        used = summary.inputs.messages_used.get(topic, 0) + summary.inputs.copied.get(topic, 0)
        total = count + used
        if 100 * count > MAX_MISSING_PERCENT * total and (count > MAX_MISSING or not used):
            findings.append(
                f"{topic}: expected at most {MAX_MISSING_PERCENT:g} % of the messages dropped, "
                f"found {count} of {total} ({100 * count / total:.1f} %)"
            )
    return findings
