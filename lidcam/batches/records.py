"""Records of the jobs of a batch: JSON files beside the results, which show what is missing or changed."""

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from hashlib import sha256
from importlib.metadata import version
from typing import Literal

from pydantic import TypeAdapter, ValidationError

from lidcam.batches.jobs import BatchJob, files_of
from lidcam.outputs.bucket import Bucket
from lidcam.outputs.written import WrittenFile, written_file
from lidcam.pipeline.core.text import brief
from lidcam.readers.files.remote import open_remote
from lidcam.readers.location import Location, RemotePath
from lidcam.readers.ouster.description import descriptions_beside
from lidcam.run.summary import RunSummary
from lidcam.writers.outputs.marks import is_unchanged_text, marked_json

END_BYTES = 1 << 16

State = Literal["begun", "done", "incomplete", "failed", "busy"]

EXIT_CODES = {"done": 0, "incomplete": 3}
"""Exit codes of jobs that have results."""


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
    # Its results by the name of the file, relative to the folder of the batch
    outputs: Mapping[str, WrittenFile] | None = None
    frames: int = 0  # Number of frames
    objects: Mapping[str, int] | None = None  # Fused objects of all frames, by class
    road_users: Mapping[str, int] | None = None  # Road users by class; None where nothing is tracked
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
    reused: bool = False  # Whether the results of an earlier batch are up to date; never so in a file

    @property
    def shown_state(self) -> str:
        """The state in words: `up to date` where nothing had to be done."""
        return "up to date" if self.reused and self.state == "done" else self.state

    def is_current(self, key: str) -> bool:
        """Whether there were results, which are up to date if nobody has changed them."""
        return self.key == key and self.exit_code is not None and EXIT_CODES.get(self.state) == self.exit_code


RECORD = TypeAdapter(JobRecord)


def with_outputs(record: JobRecord, places: Sequence[Location]) -> JobRecord:
    """The record of a job with the results that it has written, which are in one folder."""
    folder, slash, _ = record.name.rpartition("/")
    outputs = {}
    for place in places:
        if isinstance(place, RemotePath):
            written = Bucket(RemotePath(place.url.rpartition("/")[0])).written(place.name)
        else:
            written = written_file(place)
        if written is not None:
            outputs[f"{folder}{slash}{place.name}"] = written
    return replace(record, outputs=outputs)


def with_summary(record: JobRecord, summary: RunSummary) -> JobRecord:
    """The record of a job that has ended with this summary."""
    state: State = "incomplete" if summary.incomplete else "done"
    users = summary.road_users
    objects: Counter[str] = Counter()
    for (class_name, _), count in summary.frames.objects.items():
        objects[class_name] += count
    return replace(
        record,
        state=state,
        exit_code=EXIT_CODES[state],
        message="; ".join(summary.incomplete),
        frames=summary.frames.count,
        objects=dict(sorted(objects.items())),
        road_users=None if users is None else {one.class_name: one.count for one in users.counts if not one.zone},
        dropped=sum(drop.count for drop in summary.drops.messages),
        skew_max_ms=summary.frames.skew_max_ms,
        lacking={sensor.sensor: sensor.frames for sensor in summary.sensors.missing},
        sha256=tuple(file.sha256 for file in summary.inputs.files if file.sha256),
        settings=summary.settings.name,
        settings_sha256=summary.settings_sha256,
        version=version("lidcam"),
    )


def totals_line(records: Sequence[JobRecord]) -> str:
    """How the jobs ended, and what all results hold together."""
    states, users = Counter(one.shown_state for one in records), Counter[str]()
    for one in records:
        users.update(one.road_users or {})
    ended = ", ".join(f"{states[name]} {name}" for name in sorted(states))
    found = f"; road users: {', '.join(f'{count} {name}' for name, count in sorted(users.items()))}" if users else ""
    return f"{ended}; {sum(one.frames for one in records)} frames{found}"


def job_key(job: BatchJob, facts: Sequence[object]) -> str:
    """Hexadecimal digest of a recording and of other facts.

    Local files count by name, size, first and last bytes, files on a server by the facts that it gives.
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
    for file in files_of(place):
        size = file.stat().st_size
        digest.update(f"{file.name} {size}\n".encode())
        with file.open("rb") as stream:
            for at in (0, max(size - END_BYTES, 0)):
                stream.seek(at)
                digest.update(stream.read(END_BYTES))
    for file, text in descriptions_beside([place]):
        digest.update(f"{file.name} {text}\n".encode())
    return digest.digest()


def record_text(record: JobRecord) -> bytes:
    """A record as JSON with its checksum."""
    return marked_json(json.dumps(asdict(record), indent=1) + "\n").encode()


def record_of(text: bytes) -> JobRecord | None:
    """The record in a text; None where there is none, or one that was changed since it was written."""
    try:
        return RECORD.validate_json(text, strict=True) if is_unchanged_text(text.decode()) else None
    except (ValidationError, UnicodeDecodeError):
        return None


@dataclass(frozen=True, slots=True)
class BatchResult:
    """A batch that has ended.

    Attributes:
        records: What became of each recording, in the order of their names.
        table: The Parquet file with these records.
    """

    records: tuple[JobRecord, ...]
    table: str

    __repr__ = brief

    @property
    def failed(self) -> tuple[JobRecord, ...]:
        """The records of the recordings without a result; `message` says why."""
        return tuple(record for record in self.records if record.state == "failed")
