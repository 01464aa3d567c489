"""What `--strict` asks of a run."""

from collections import Counter
from typing import NamedTuple

from lidcam.commands.verdict import first_of
from lidcam.report import RunReport

__all__ = ["MAX_DROPPED_PERCENT", "Strictness"]

MAX_DROPPED_PERCENT = 5.0
"""Of a topic, unless the user says otherwise: what a lost message now and then costs."""

ENDS = 2
"""Messages of a topic: one at either end of a recording may have no partners, however short it is."""


class Strictness(NamedTuple):
    """How much of the recording a run has to use.

    Attributes:
        max_dropped_percent: Share of a topic's messages that may be dropped, and of the frames in which a sensor may
            be silent.
    """

    max_dropped_percent: float = MAX_DROPPED_PERCENT

    def failure(self, report: RunReport) -> str:
        """What was left out, silent, dropped or damaged beyond what is allowed, in one line; empty if nothing was."""
        findings = [*_left_out(report), *self._silent(report), *self._dropped(report), *_damaged(report)]
        return f"--strict: {first_of(findings)}; the outputs are complete" if findings else ""

    def _silent(self, report: RunReport) -> list[str]:
        """Sensors that fell silent; not those that are missing from frames because they are slower than others."""
        findings = []
        for sensor in report.sensors.missing:
            frames = sum(span.frames for span in sensor.silences)
            if 100 * frames > self.max_dropped_percent * sensor.of_frames and frames > ENDS:
                findings.append(f"{sensor.sensor}: {sensor.spans}, {frames} of {sensor.of_frames} frames lack it")
        return findings

    def _dropped(self, report: RunReport) -> list[str]:
        dropped: Counter[str] = Counter()
        for drop in report.drops.messages:
            if drop.unit == "messages":
                dropped[drop.topic] += drop.count
        findings = []
        for topic, count in sorted(dropped.items()):
            used = report.inputs.messages_used.get(topic, 0) + report.inputs.copied.get(topic, 0)
            total = count + used
            if 100 * count > self.max_dropped_percent * total and (count > ENDS or not used):
                share = f"{100 * count / total:.1f} %"
                findings.append(
                    f"{topic}: expected at most {self.max_dropped_percent:g} % of the messages dropped, "
                    f"found {count} of {total} ({share})"
                )
        return findings


def _left_out(report: RunReport) -> list[str]:
    return [f"{fault.subject} is left out: {fault.reason}" for fault in report.sensors.faults]


def _damaged(report: RunReport) -> list[str]:
    parts = Counter(str(loss.path) for loss in report.inputs.losses)
    return [f"{path}: {count} damaged part{'s' if count > 1 else ''}" for path, count in sorted(parts.items())]
