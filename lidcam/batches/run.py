"""A batch from its arguments to its table: processes what is missing or changed, largest recordings first."""

import base64
import logging
import re
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, closing, nullcontext
from dataclasses import dataclass, replace
from functools import partial
from hashlib import sha256
from importlib.metadata import version
from pathlib import PurePosixPath
from typing import Literal, Unpack
from urllib.parse import quote

import cv2
import numpy as np

from lidcam.batches.jobs import INDEX, BatchJob, find_jobs
from lidcam.batches.local import JOB_MIB, Engine, LocalEngine, Task
from lidcam.batches.ray import RayEngine
from lidcam.batches.records import BatchResult, JobRecord, job_key, totals_line
from lidcam.batches.store import TABLE, LocalFiles, Store, records_table
from lidcam.outputs.registry import endings_of
from lidcam.pipeline.core.errors import ConfigError, OutputError, RecordingError
from lidcam.pipeline.core.system import free_memory_mib
from lidcam.pipeline.core.text import visible
from lidcam.pipeline.parallel.cores import usable_cores
from lidcam.readers.location import Location
from lidcam.run.effect import settings_sha256
from lidcam.run.job import Job, check_options, make_job
from lidcam.run.options import SharedOptions
from lidcam.writers.outputs.marks import PAGE
from lidcam.writers.report.page import index_page

THUMBNAIL_PX = 240
"""Width of the image of a recording, pixels."""

HEAD_BYTES = 4 << 20
"""Maximum size of the head of a report in which that image is looked for."""

LINKS = {".html": "report", ".rrd": "Rerun", ".mcap": "MCAP", ".mp4": "film", ".parquet": "objects"}
"""Names of the links to results, by the ending of the file."""

_IMAGE = re.compile(rb'<div class="busiest">\s*<figure[^>]*><img src="data:image/jpeg;base64,([^"]+)"')


def keep_index(records: Sequence[JobRecord], store: Store) -> bool:
    """Write the page of a batch; returns whether it was written: a page of somebody else's stays."""
    content = index_page([_row(one, store) for one in records], totals_line(records)).encode()
    try:
        known = store.files.read(INDEX)
    except (OSError, OutputError):  # too large to be ours, or no plain file
        return False
    if known is not None and PAGE.encode() not in known[:4096]:
        return False
    store.keep_of_all(INDEX, content)
    return True


def _row(record: JobRecord, store: Store) -> dict[str, object]:
    names = {PurePosixPath(name).suffix: name for name in record.outputs or {}}
    users = record.road_users
    return {
        "name": record.name,
        "state": record.shown_state,
        "message": record.message,
        "frames": record.frames or "",
        "users": "" if users is None else ", ".join(f"{count} {name}" for name, count in users.items()),
        "dropped": record.dropped or "",
        "links": [(label, quote(names[ending])) for ending, label in LINKS.items() if ending in names],
        "thumbnail": _thumbnail(names[".html"], store) if ".html" in names else "",
    }


def _thumbnail(report: str, store: Store) -> str:
    """The image of the busiest moment in a report, small, as a data URI; empty without one at hand."""
    if not isinstance(store.files, LocalFiles):
        return ""
    with store.files.at(report).open("rb") as file:
        found = _IMAGE.search(file.read(HEAD_BYTES))
    image = cv2.imdecode(np.frombuffer(base64.b64decode(found[1]), np.uint8), cv2.IMREAD_COLOR) if found else None
    if image is None:
        return ""
    size_px = THUMBNAIL_PX, max(round(THUMBNAIL_PX * image.shape[0] / image.shape[1]), 1)
    _, jpeg = cv2.imencode(".jpg", cv2.resize(image, size_px, interpolation=cv2.INTER_AREA))
    return f"data:image/jpeg;base64,{base64.b64encode(jpeg.tobytes()).decode()}"


logger = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class BatchOptions:
    """The processing of each recording."""

    out: Location  # Folder of the results, local or of an object store
    # The job of each recording, without inputs and outputs; `overwrite` also reprocesses results that are up to date
    job: Job
    endings: Sequence[str] = ()  # Further outputs of each recording, by the endings of their names

    def facts(self) -> list[object]:
        """All that results depend on besides the recording."""
        job, choice = self.job, self.job.settings
        settings = [settings_sha256(one) for one in (choice.config, *choice.by_preset.values())]
        files = [sha256(path.read_bytes()).hexdigest() for path in job.read_files]
        part = job.start_s, job.duration_s, job.on_bad_message
        rig = job.rig and job.rig.model_dump_json()
        return [version("lidcam"), settings, rig, part, files, *self.endings]


def run_batch(
    jobs: Sequence[BatchJob], options: BatchOptions, engine: Engine, told: Callable[[JobRecord], None]
) -> list[JobRecord]:
    """Process the recordings; returns their records in the order of the jobs.

    `told` gets the record of each job that has ended, or was up to date.
    """
    ordered = sorted(jobs, key=lambda job: (-job.bytes, job.name))
    found: dict[str, JobRecord] = {}
    store, facts = Store(options.out), options.facts()
    with closing(engine.outcomes([partial(_done, job, options, store, facts) for job in ordered])) as outcomes:
        for record in outcomes:
            found[record.name] = record
            told(record)
    # What another batch had at work may be ready by now.
    busy = {name: store.record(name) for name, record in found.items() if record.state == "busy"}
    ended = {name: record for name, record in busy.items() if record is not None and record.exit_code is not None}
    return [ended.get(job.name, found[job.name]) for job in jobs]


def _done(job: BatchJob, options: BatchOptions, store: Store, facts: Sequence[object], engine: Engine) -> JobRecord:
    """The record of a job that has ended, or is up to date."""
    begun = JobRecord(job.name, job.shown_inputs, "", "begun")
    if job.fault:
        return replace(begun, state="failed", exit_code=1, message=job.fault)
    names = [f"{job.name}{ending}" for ending in (".mcap", *options.endings)]
    try:
        begun = replace(begun, key=job_key(job, facts))
        with store.held(job.name) as lock:
            known = store.record(job.name)
            if known is not None and known.is_current(begun.key) and not options.job.overwrite:
                outputs = known.outputs or {}
                if all(name in outputs and store.files.written(name, outputs[name]) == outputs[name] for name in names):
                    return replace(known, input=begun.input, reused=True)
                logger.warning("%s: a result is missing or was changed: it is processed again", job.name)
            if lock is None:
                return replace(begun, state="busy", message="another batch is processing it")
            if known is not None and known.state == "begun":
                logger.warning("%s: an earlier batch was killed while it ran: it is processed again", job.name)
            store.keep(begun)
            task = Task(begun, replace(options.job, inputs=job.inputs), tuple(map(store.files.at, names)))
            record = engine.run(task, keep_open=lock)
            store.keep(record)
            return record
    except (OSError, OutputError, RecordingError) as err:  # of this one; others may be done
        line = str(err)
        if isinstance(err, OSError):
            line = f"{err.filename or job.name}: cannot be read or written: {err.strerror}"
        return replace(begun, state="failed", exit_code=1, message=visible(line))


WatchBatch = Callable[[Sequence[BatchJob]], AbstractContextManager[Callable[[JobRecord], None]]]
"""Gets the recordings, and yields a function that is called with the record of each that has ended."""


def not_watched(_: Sequence[BatchJob]) -> AbstractContextManager[Callable[[JobRecord], None]]:
    """Shows nothing."""
    return nullcontext(lambda _: None)


def process_batch(
    recordings: Sequence[str],
    out: Location,
    *,
    jobs: int | None = None,
    engine: Literal["local", "ray"] = "local",
    address: str | None = None,
    outputs: Mapping[str, bool],
    overwrite: bool = False,
    watch: WatchBatch = not_watched,
    **options: Unpack[SharedOptions],
) -> BatchResult:
    """Process many recordings, as `lidcam.batch` says.

    `outputs` says of options of `lidcam process` (`--rerun`) whether these outputs are wanted, too; `watch` shows the
    progress. Raises LidcamError if the settings, the rig or an output is at fault, or there are no recordings.
    """
    check_options(options, SharedOptions, "lidcam.batch")
    if engine not in {"local", "ray"}:
        raise ConfigError(f"engine: expected local or ray, found {engine!r}")
    if jobs is not None and jobs < 1:
        raise ConfigError(f"jobs: expected 1 or more, found {jobs}")
    if address is not None and engine != "ray":
        raise ConfigError("address: expected the engine ray with it")
    found = find_jobs(recordings, out)
    at_once = min(jobs or max(min(usable_cores(), free_memory_mib() // JOB_MIB), 1), len(found))
    job = make_job((), overwrite=overwrite, **options)  # settings, rig and network are checked once
    cores = job.config.run.workers or (1 if address else max(usable_cores() // at_once, 1))
    if job.config.run.workers is None:
        options["workers"] = cores
        job = make_job((), overwrite=overwrite, **options)
    endings = [endings_of(option)[0] for option, is_wanted in outputs.items() if is_wanted]
    store = Store(out)
    runs = RayEngine(jobs if address else at_once, cores, address) if engine == "ray" else LocalEngine(at_once)
    with watch(found) as told:
        records = run_batch(found, BatchOptions(out, job, endings), runs, told)
    store.keep_of_all(TABLE, records_table(records))
    if not keep_index(records, store):
        logger.warning("%s/%s was not written by lidcam: it stays as it is", str(out).rstrip("/"), INDEX)
    return BatchResult(tuple(records), f"{str(out).rstrip('/')}/{TABLE}")
