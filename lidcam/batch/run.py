"""A batch: what is missing is processed, longest recordings first; what is there and current stays."""

import json
import logging
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from functools import partial

from lidcam.batch.engine import Engine
from lidcam.batch.jobs import BatchJob
from lidcam.batch.records import JobRecord, State, job_key
from lidcam.batch.store import Store, open_store
from lidcam.pipeline.core.errors import OutputError, RecordingError
from lidcam.readers.location import Location

logger = logging.getLogger(__name__)

STATES: dict[int, State] = {0: "done", 3: "incomplete"}
"""By exit code; all others are failures."""

PREFIXES = ("lidcam: error: ", "lidcam: incomplete: ")


@dataclass(frozen=True, slots=True)
class BatchOptions:
    """What is done to each recording.

    Attributes:
        out: Folder of the results, local or of an object store.
        arguments: Options of `lidcam process`, as on its command line.
        outputs: Further outputs of each recording: the option, and the ending of its file.
        facts: All that results depend on besides the recording.
        overwrite: Make again what is current, too, and replace files of those names that are no results.
        fail_fast: Begin no other job after one that failed.
    """

    out: Location
    arguments: Sequence[str]
    outputs: Sequence[tuple[str, str]]
    facts: Sequence[str]
    overwrite: bool = False
    fail_fast: bool = False


def run_batch(
    jobs: Sequence[BatchJob], options: BatchOptions, engine: Engine, told: Callable[[JobRecord], None]
) -> list[JobRecord]:
    """Process the recordings; their records in the order of the jobs, those that were not begun left out.

    Args:
        jobs: Of `find_jobs`.
        options: What is done to each.
        engine: Runs them.
        told: Called with the record of each job that has ended, or was current already.

    Raises:
        OutputError: the folder cannot be written to.
    """
    ordered = sorted(jobs, key=lambda job: (-job.bytes, job.name))
    found: dict[str, JobRecord] = {}
    try:
        store = open_store(options.out)
        with closing(engine.outcomes([partial(_done, job, options, store) for job in ordered])) as outcomes:
            for record in outcomes:
                found[record.name] = record
                told(record)
                if options.fail_fast and record.state == "failed":
                    break
    except OSError as err:
        raise OutputError(f"{options.out}: expected a folder that can be written to: {err}") from err
    return [found[job.name] for job in jobs if job.name in found]


def _done(job: BatchJob, options: BatchOptions, store: Store, engine: Engine) -> JobRecord:
    """The record of a job that has ended, or is current already."""
    shown = ", ".join(map(str, job.inputs))
    try:
        key = job_key(job, options.facts)
    except OSError as err:
        return JobRecord(
            job.name, shown, "", "failed", 1, f"{err.filename}: expected a file that can be read: {err.strerror}"
        )
    except RecordingError as err:
        return JobRecord(job.name, shown, "", "failed", 1, str(err))
    try:
        return _kept(job, options, store, engine, JobRecord(job.name, shown, key, "begun"))
    except OutputError as err:  # the store refuses this one, and may take others
        return JobRecord(job.name, shown, key, "failed", 1, str(err))


def _kept(job: BatchJob, options: BatchOptions, store: Store, engine: Engine, begun: JobRecord) -> JobRecord:
    """The same of a recording that can be read; kept in the store."""
    with store.held(job.name) as lock:
        known = store.record(job.name)
        if known is not None and known.is_current(begun.key, store.size) and not options.overwrite:
            return known
        if lock is None:
            return replace(begun, state="busy", message="another batch is at work on it")
        if known is not None and known.state == "begun":
            logger.warning("%s: an earlier batch ended while it was at work on it: it is processed again", job.name)
        store.keep(begun)
        record = _processed(job, options, store, engine, begun, lock)
        store.keep(record)
        return record


def _processed(
    job: BatchJob, options: BatchOptions, store: Store, engine: Engine, begun: JobRecord, lock: int
) -> JobRecord:
    outputs = {"": f"{job.name}.mcap"} | {option: _named(job.name, ending) for option, ending in options.outputs}
    places = {option: store.place(name) for option, name in outputs.items()}
    inputs = [getattr(one, "url", str(one)) for one in job.inputs]
    arguments = [*inputs, places.pop(""), *options.arguments, "--quiet", *["--overwrite"] * options.overwrite]
    arguments += [text for option, place in places.items() for text in (option, place)]
    outcome = engine.run(arguments, keep_open=lock)
    record = replace(
        begun,
        state=STATES.get(outcome.exit_code, "failed"),
        exit_code=outcome.exit_code,
        processor_s=round(outcome.processor_s, 2),
        wall_s=round(outcome.wall_s, 2),
        peak_mib=round(outcome.peak_mib, 1),
    )
    if outcome.figures:
        record = record.with_figures(json.loads(outcome.figures))
    if record.state == "failed":
        line = outcome.message
        for prefix in PREFIXES:
            line = line.removeprefix(prefix)
        return replace(record, message=line or f"ended by signal {-outcome.exit_code}")
    sizes = {name: store.size(name) for name in outputs.values()}
    return replace(record, outputs={name: size for name, size in sizes.items() if size is not None})


def _named(job: str, ending: str) -> str:
    """The name of an output; that of a folder has no dots, which would look like the ending of a file."""
    folder, slash, name = job.rpartition("/")
    return f"{folder}{slash}{name if ending.startswith('.') else name.replace('.', '_')}{ending}"
