"""A batch from its arguments to its table: processes what is missing or changed, largest recordings first."""

import logging
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, closing, nullcontext
from dataclasses import dataclass, replace
from functools import partial
from hashlib import sha256
from importlib.metadata import version
from typing import Literal, Unpack

from lidcam.batches.engine import Engine, Task
from lidcam.batches.index import index_of, keep_index
from lidcam.batches.jobs import INDEX, BatchJob, find_jobs
from lidcam.batches.local import LocalEngine, jobs_that_fit
from lidcam.batches.ray import RayEngine
from lidcam.batches.records import BatchResult, JobRecord, job_key, totals_line
from lidcam.batches.store import TABLE, Store, records_table
from lidcam.outputs.registry import endings_of
from lidcam.pipeline.core.errors import ConfigError, OutputError, RecordingError
from lidcam.pipeline.core.text import visible
from lidcam.pipeline.parallel.cores import usable_cores
from lidcam.readers.location import Location
from lidcam.run.effect import settings_sha256
from lidcam.run.job import Job, check_options, make_job
from lidcam.run.options import SharedOptions

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

    Args:
        jobs: The recordings, from `find_jobs`.
        options: Their processing.
        engine: Runs them.
        told: Called with the record of each job that has ended, or was up to date.

    Raises:
        OutputError: the folder cannot be written to.
    """
    ordered = sorted(jobs, key=lambda job: (-job.bytes, job.name))
    found: dict[str, JobRecord] = {}
    store, facts = Store(options.out), options.facts()
    with closing(engine.outcomes([partial(_done, job, options, store, facts) for job in ordered])) as outcomes:
        for record in outcomes:
            found[record.name] = record
            told(record)
    # What another batch had at work may be ready by now.
    busy = {name: store.finished(name) for name, record in found.items() if record.state == "busy"}
    return [busy.get(job.name) or found[job.name] for job in jobs]


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
    outputs: Sequence[str] = (),
    overwrite: bool = False,
    watch: WatchBatch = not_watched,
    **options: Unpack[SharedOptions],
) -> BatchResult:
    """Process many recordings, as `lidcam.batch` says.

    `outputs` are the options of `lidcam process` that name further outputs (`--rerun`); `watch` shows the progress.

    Raises:
        LidcamError: the settings, the rig or an output is at fault, or there are no recordings.
    """
    check_options(options, SharedOptions, "lidcam.batch")
    if engine not in {"local", "ray"}:
        raise ConfigError(f"engine: expected local or ray, found {engine!r}")
    if jobs is not None and jobs < 1:
        raise ConfigError(f"jobs: expected 1 or more, found {jobs}")
    if address is not None and engine != "ray":
        raise ConfigError("address: expected the engine ray with it")
    found = find_jobs(recordings, out)
    at_once = min(jobs or jobs_that_fit(len(found)), len(found))
    job = make_job((), overwrite=overwrite, **options)  # settings, rig and network are checked once
    cores = job.config.run.workers or (1 if address else max(usable_cores() // at_once, 1))
    if job.config.run.workers is None:
        options["workers"] = cores
        job = make_job((), overwrite=overwrite, **options)
    endings = [endings_of(option)[0] for option in outputs]
    store = Store(out)
    runs = RayEngine(jobs if address else at_once, cores, address) if engine == "ray" else LocalEngine(at_once)
    with watch(found) as told:
        records = run_batch(found, BatchOptions(out, job, endings), runs, told)
    store.keep_table(records_table(records))
    if not keep_index(index_of(records, totals_line(records), store), store):
        logger.warning("%s/%s was not written by lidcam: it stays as it is", str(out).rstrip("/"), INDEX)
    return BatchResult(tuple(records), f"{str(out).rstrip('/')}/{TABLE}")
