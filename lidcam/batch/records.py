"""What a batch knows of each job: a small JSON file beside the results, by which a second run does what is missing."""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from hashlib import sha256
from pathlib import Path
from typing import Any, Literal

from lidcam.batch.jobs import BatchJob
from lidcam.readers.files.remote import open_remote
from lidcam.readers.location import Location, RemotePath

FOLDER = ".lidcam-batch"
"""In the folder of the results."""

END_BYTES = 1 << 16

State = Literal["begun", "done", "incomplete", "failed", "busy"]


@dataclass(frozen=True, slots=True)
class JobRecord:
    """One job, as it stands.

    Attributes:
        name: What its results are called, without ending.
        input: Its files, without credentials.
        key: Of recording, settings, rig, network and version; equal keys have equal results.
        state: `begun`: an earlier batch was killed while it was at work; `busy`: another batch is at work on it.
        exit_code: As of `lidcam process`; negative: ended by that signal; None while it has none.
        message: The line of error, or of what was incomplete.
        outputs: Sizes in bytes by the name of the file, relative to the folder of the batch.
        frames: Number of frames.
        objects: Fused objects of all frames, by class.
        dropped: Messages that were not used.
        skew_max_ms: Largest spread of the stamps in a frame; None without frames.
        lacking: Frames without a sensor that was recorded, by sensor.
        processor_s: Processor time of the job with all its processes, seconds.
        wall_s: How long it took, seconds.
        peak_mib: Largest memory of one of its processes.
        sha256: Of the inputs that were read as a whole, in order.
        settings: Name of the settings.
        settings_sha256: Checksum of the settings that affect the result.
        version: Of lidcam.
    """

    name: str
    input: str
    key: str
    state: State
    exit_code: int | None = None
    message: str = ""
    outputs: Mapping[str, int] | None = None
    frames: int = 0
    objects: Mapping[str, int] | None = None
    dropped: int = 0
    skew_max_ms: float | None = None
    lacking: Mapping[str, int] | None = None
    processor_s: float = 0.0
    wall_s: float = 0.0
    peak_mib: float = 0.0
    sha256: Sequence[str] = ()
    settings: str = ""
    settings_sha256: str = ""
    version: str = ""

    def with_figures(self, tree: Mapping[str, Any]) -> "JobRecord":
        """With what `lidcam process --json` says."""
        objects: dict[str, int] = {}
        for one in tree["objects"]:
            objects[one["class"]] = objects.get(one["class"], 0) + one["count"]
        return replace(
            self,
            message=tree["failure"] or "; ".join(tree["incomplete"]),
            frames=tree["frames"],
            objects=dict(sorted(objects.items())),
            dropped=sum(drop["count"] for drop in tree["drops"]),
            skew_max_ms=tree["sync"]["skew_max_ms"],
            lacking={one["sensor"]: one["frames"] for one in tree["missing"]},
            sha256=tuple(one["sha256"] for one in tree["inputs"] if one["sha256"]),
            settings=tree["settings"]["name"],
            settings_sha256=tree["settings"]["sha256"],
            version=tree["lidcam_version"],
        )

    def is_current(self, key: str, size_of: Callable[[str], int | None]) -> bool:
        """Whether the results are there, of these sizes, and need not be made again."""
        if self.key != key or self.state not in {"done", "incomplete"}:
            return False
        return all(size_of(name) == size for name, size in (self.outputs or {}).items())


def job_key(job: BatchJob, facts: Sequence[str]) -> str:
    """Hexadecimal digest of a recording and of other facts.

    Of files the names, sizes, beginnings and ends count; of a file on a server what that says of it.

    Raises:
        OSError: one cannot be read.
        RecordingError: a server does not give it.
    """
    digest = sha256(repr([*facts]).encode())
    for one in job.inputs:
        digest.update(_ends(one))
    return digest.hexdigest()


def record_text(record: JobRecord) -> bytes:
    """A record as JSON."""
    return (json.dumps(asdict(record), indent=1) + "\n").encode()


def record_of(text: bytes) -> JobRecord | None:
    """The record that a text holds; None where it holds none."""
    try:
        tree = json.loads(text)
        return JobRecord(**{field.name: tree[field.name] for field in fields(JobRecord)})
    except (ValueError, KeyError, TypeError):
        return None


def read_record(path: Path) -> JobRecord | None:
    """The record of a job; None where there is none that can be read."""
    try:
        return record_of(path.read_bytes())
    except OSError:
        return None


def write_record(path: Path, record: JobRecord) -> None:
    """Write it whole or not at all.

    Raises:
        OSError: it cannot be written.
    """
    beside = path.with_name(f"{path.name}.new")
    beside.write_bytes(record_text(record))
    beside.replace(path)


def _ends(place: Location) -> bytes:
    if isinstance(place, RemotePath):
        found, stream = open_remote(place)
        stream.close()
        return repr((str(place), found.facts)).encode()
    digest = sha256()
    files = sorted(one for one in place.rglob("*") if one.is_file()) if place.is_dir() else [place]
    for file in files:
        size = file.stat().st_size
        digest.update(f"{file.name} {size}\n".encode())
        with file.open("rb") as stream:
            for at in (0, max(size - END_BYTES, 0)):
                stream.seek(at)
                digest.update(stream.read(END_BYTES))
    return digest.digest()
