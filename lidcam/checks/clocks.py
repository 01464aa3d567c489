"""Notes and warnings about the clocks of sensors and recorder."""

from collections.abc import Mapping, Sequence

from lidcam.checks.warning import RunWarning
from pipeline.stages.sync.clocks import Clocks, TimeJump

__all__ = ["clock_notes", "jump_warnings"]

MAX_JUMPS_NAMED = 5
"""Jumps with a warning of their own."""

MAX_SENSORS_NAMED = 10
"""Sensors in one note."""


def jump_warnings(jumps: Sequence[TimeJump], *, start_ns: int) -> list[RunWarning]:
    """One for each of the first jumps of time; `start_ns` is the log time at which the recording starts."""
    warnings = [_warning(jump, start_ns) for jump in jumps[:MAX_JUMPS_NAMED]]
    if more := len(jumps) - len(warnings):
        remedy = "look at the clocks of the sensors with `lidcam inspect`"
        warnings.append(RunWarning("time", f"jumps back {more} times more", remedy))
    return warnings


def clock_notes(clocks: Clocks, sensors: Mapping[str, str]) -> list[str]:
    """Notes about sensors without stamps; `sensors` names them by topic."""
    names = [sensors.get(topic, topic) for topic in clocks.unstamped]
    if not names:
        return []
    more = f" and {len(names) - MAX_SENSORS_NAMED} more" if len(names) > MAX_SENSORS_NAMED else ""
    listed = ", ".join(names[:MAX_SENSORS_NAMED])
    return [f"{listed}{more}: all stamps are 0, so the times at which the messages were recorded are used"]


def _warning(jump: TimeJump, start_ns: int) -> RunWarning:
    where = f"by {jump.by_ns / 1e9:.1f} s at {(jump.at_ns - start_ns) / 1e9:.1f} s"
    if jump.kind == "log times":
        finding = f"log times jump back {where}: the parts before and after are processed one after the other"
        return RunWarning("time", finding, "if they are two recordings, record them into two files")
    finding = f"stamps jump back {where}: no frame has messages of both sides"
    remedy = "if it was played in a loop, take one turn of it with --start and --duration"
    return RunWarning("time", finding, remedy)
