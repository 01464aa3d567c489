"""The check of `--strict`: how much of the recording a run has to use."""

from collections import Counter
from typing import TYPE_CHECKING

from lidcam.cli.verdict import first_of

if TYPE_CHECKING:
    from lidcam.run.summary import RunSummary


MAX_MISSING_PERCENT = 5.0
"""Share of a topic's messages that may be dropped, and of the frames in which a sensor may be silent."""

MAX_MISSING = 2
"""Messages and frames that may be missing however short a recording is: one at either end may have no partners."""


def strict_failure(report: "RunSummary") -> str:
    """One line about what was left out, silent, dropped or damaged beyond the limits; empty if nothing was."""
    damaged = Counter(str(loss.path) for loss in report.inputs.losses)
    findings = [
        *(f"{fault.subject} is left out: {fault.reason}" for fault in report.sensors.faults),
        *_silent(report),
        *_dropped(report),
        *(f"{path}: {count} damaged part{'s' * (count > 1)}" for path, count in sorted(damaged.items())),
    ]
    return f"--strict: {first_of(findings)}; the outputs are complete" if findings else ""


def _silent(report: "RunSummary") -> list[str]:
    """Sensors that fell silent; not those that are missing from frames because they are slower than others."""
    findings = []
    for sensor in report.sensors.missing:
        frames = sum(span.frames for span in sensor.silences)
        if 100 * frames > MAX_MISSING_PERCENT * sensor.of_frames and frames > MAX_MISSING:
            findings.append(f"{sensor.sensor}: {sensor.spans}, {frames} of {sensor.of_frames} frames lack it")
    return findings


def _dropped(report: "RunSummary") -> list[str]:
    from lidcam.run.frames import NOT_EVERY

    dropped: Counter[str] = Counter()
    for drop in report.drops.messages:
        if drop.unit == "messages" and drop.reason != NOT_EVERY:
            dropped[drop.topic] += drop.count
    findings = []
    for topic, count in sorted(dropped.items()):
        used = report.inputs.messages_used.get(topic, 0) + report.inputs.copied.get(topic, 0)
        total = count + used
        if 100 * count > MAX_MISSING_PERCENT * total and (count > MAX_MISSING or not used):
            findings.append(
                f"{topic}: expected at most {MAX_MISSING_PERCENT:g} % of the messages dropped, "
                f"found {count} of {total} ({100 * count / total:.1f} %)"
            )
    return findings
