"""Short lines about the part of a recording that could not be used: why a command ends with exit code 3."""

from collections import defaultdict
from collections.abc import Iterable, Sequence

from lidcam.readers.recording import Loss
from lidcam.readers.rig.sensor_topics import SensorFault
from lidcam.run.missing import MissingSensor, absent_sensors


def left_out_lines(faults: Sequence[SensorFault]) -> list[str]:
    """One for each sensor that is left out."""
    return [f"{fault.subject} is left out" for fault in faults]


def absent_lines(missing: Sequence[MissingSensor]) -> list[str]:
    """One for each sensor that was recorded and is in no frame."""
    return [f"{sensor.sensor} is in none of the {sensor.of_frames} frames" for sensor in absent_sensors(missing)]


def changed_lines(paths: Iterable[str]) -> list[str]:
    """One for each file that was changed while it was read: nobody can say which content a result is of."""
    return [f"{path}: changed while it was read; run it again when nothing writes to it" for path in paths]


def damage_lines(losses: Sequence[Loss]) -> list[str]:
    """One for each file of which messages are lost, or may be; a file that was not closed may have lost none."""
    of_file: defaultdict[str, list[int | None]] = defaultdict(list)
    for loss in losses:
        if loss.messages != 0:
            of_file[str(loss.path)].append(loss.messages)
    return [f"{path}: {_damage(counts)}" for path, counts in sorted(of_file.items())]


def _damage(counts: Sequence[int | None]) -> str:
    known = [count for count in counts if count is not None]
    messages = f"{sum(known)} message{'s' * (sum(known) != 1)}"
    if len(known) == len(counts):
        return f"damaged, {messages} lost"
    return f"damaged, {messages} or more lost" if known else "damaged, an unknown number of messages lost"
