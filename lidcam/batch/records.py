"""Records of the jobs of a batch: JSON files beside the results, which show what is missing or changed."""

import json
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from hashlib import sha256
from importlib.metadata import version
from typing import Literal

from lidcam.batch.jobs import BatchJob
from lidcam.readers.files.remote import open_remote
from lidcam.readers.location import Location, RemotePath
from lidcam.run.summary import RunSummary

FOLDER = ".lidcam-batch"
"""Folder of the records, in that of the results."""

END_BYTES = 1 << 16

State = Literal["begun", "done", "incomplete", "failed", "busy"]


@dataclass(frozen=True, slots=True)
class JobRecord:
    """The state of one job."""

    name: str  # Name of its results, without ending
    input: str  # Its files, without credentials
    key: str  # Digest of recording, settings, rig, network and version; equal keys have equal results
    state: State  # `begun`: an earlier batch was killed while it ran; `busy`: another batch is running it
    # As `lidcam process` would exit; negative: ended by that signal; None while it has none
    exit_code: int | None = None
    message: str = ""  # The line of error, or of what was incomplete
    # Sizes in bytes by the name of the file, relative to the folder of the batch
    outputs: Mapping[str, int] | None = None
    frames: int = 0  # Number of frames
    objects: Mapping[str, int] | None = None  # Fused objects of all frames, by class
    dropped: int = 0  # Messages that were not used
    skew_max_ms: float | None = None  # Largest spread of the stamps in a frame; None without frames
    lacking: Mapping[str, int] | None = None  # Frames without a sensor that was recorded, by sensor
    processor_s: float = 0.0  # Processor time of the job with all its processes, seconds
    wall_s: float = 0.0  # Duration, seconds
    peak_mib: float = 0.0  # Largest memory of one of its processes
    sha256: Sequence[str] = ()  # Checksums of the inputs that were read in full, in order
    settings: str = ""  # Name of the settings
    settings_sha256: str = ""  # Checksum of the settings that affect the result
    version: str = ""  # Version of lidcam

    def is_current(self, key: str, size_of: Callable[[str], int | None]) -> bool:
        """Whether the results exist, with these sizes, and are up to date."""
        if self.key != key or self.state not in {"done", "incomplete"}:
            return False
        return all(size_of(name) == size for name, size in (self.outputs or {}).items())


def with_summary(record: JobRecord, summary: RunSummary) -> JobRecord:
    """The record of a job that has ended with this summary."""
    objects: Counter[str] = Counter()
    for (class_name, _), count in summary.frames.objects.items():
        objects[class_name] += count
    return replace(
        record,
        state="incomplete" if summary.incomplete else "done",
        exit_code=3 if summary.incomplete else 0,
        message="; ".join(summary.incomplete),
        frames=summary.frames.count,
        objects=dict(sorted(objects.items())),
        dropped=sum(drop.count for drop in summary.drops.messages),
        skew_max_ms=summary.frames.skew_max_ms,
        lacking={sensor.sensor: sensor.frames for sensor in summary.sensors.missing},
        sha256=tuple(file.sha256 for file in summary.inputs.files if file.sha256),
        settings=summary.settings.name,
        settings_sha256=summary.settings_sha256,
        version=version("lidcam"),
    )


def job_key(job: BatchJob, facts: Sequence[object]) -> str:
    """Hexadecimal digest of a recording and of other facts.

    Local files count by name, size, first and last bytes, files on a server by the facts that it gives.

    Raises:
        OSError: one cannot be read.
        RecordingError: a server does not give it.
    """
    digest = sha256(repr([*facts]).encode())
    for one in job.inputs:
        digest.update(_ends(one))
    return digest.hexdigest()


def _ends(place: Location) -> bytes:
    if isinstance(place, RemotePath):
        found, stream = open_remote(place)
        stream.close()
        return repr((str(place), found.facts)).encode()
    digest = sha256()
    for file in sorted(one for one in place.rglob("*") if one.is_file()) if place.is_dir() else [place]:
        size = file.stat().st_size
        digest.update(f"{file.name} {size}\n".encode())
        with file.open("rb") as stream:
            for at in (0, max(size - END_BYTES, 0)):
                stream.seek(at)
                digest.update(stream.read(END_BYTES))
    return digest.digest()


def record_text(record: JobRecord) -> bytes:
    """A record as JSON."""
    return (json.dumps(asdict(record), indent=1) + "\n").encode()


def record_of(text: bytes) -> JobRecord | None:
    """The record in a text; None where there is none."""
    try:
        tree = json.loads(text)
        return JobRecord(**{field.name: tree[field.name] for field in fields(JobRecord)})
    except (ValueError, KeyError, TypeError):
        return None
