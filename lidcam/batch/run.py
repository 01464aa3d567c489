"""A batch: what is missing is processed, longest recordings first; what is there and current stays."""

import fcntl
import json
import logging
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from lidcam.batch.engine import Engine
from lidcam.batch.jobs import BatchJob
from lidcam.batch.records import FOLDER, JobRecord, State, job_key, read_record, write_record
from pipeline.core.errors import OutputError

__all__ = ["BatchOptions", "run_batch"]

logger = logging.getLogger(__name__)

STATES: dict[int, State] = {0: "done", 3: "incomplete"}
"""By exit code; all others are failures."""

PREFIXES = ("lidcam: error: ", "lidcam: incomplete: ")


@dataclass(frozen=True, slots=True)
class BatchOptions:
    """What is done to each recording.

    Attributes:
        out: Folder of the results.
        arguments: Options of `lidcam process`, as on its command line.
        outputs: Further outputs of each recording: the option, and the ending of its file.
        facts: All that results depend on besides the recording.
        overwrite: Make again what is current, too, and replace files of those names that are no results.
        fail_fast: Begin no other job after one that failed.
    """

    out: Path
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
        options.out.mkdir(parents=True, exist_ok=True)
        with closing(engine.outcomes([partial(_done, job, options) for job in ordered])) as outcomes:
            for record in outcomes:
                found[record.name] = record
                told(record)
                if options.fail_fast and record.state == "failed":
                    break
    except OSError as err:
        raise OutputError(f"{options.out}: expected a folder that can be written to: {err}") from err
    return [found[job.name] for job in jobs if job.name in found]


def _done(job: BatchJob, options: BatchOptions, engine: Engine) -> JobRecord:
    """The record of a job that has ended, or is current already."""
    place = options.out / FOLDER / f"{job.name}.json"
    place.parent.mkdir(parents=True, exist_ok=True)
    shown = ", ".join(map(str, job.inputs))
    try:
        key = job_key(job, options.facts)
    except OSError as err:
        return JobRecord(
            job.name, shown, "", "failed", 1, f"{err.filename}: expected a file that can be read: {err.strerror}"
        )
    with _locked(place.with_suffix(".lock")) as lock:
        known = read_record(place)
        if known is not None and known.is_current(key, options.out) and not options.overwrite:
            return known
        if lock is None:
            return JobRecord(job.name, shown, key, "busy", message="another batch is at work on it")
        if known is not None and known.state == "begun":
            logger.warning("%s: an earlier batch ended while it was at work on it: it is processed again", job.name)
        begun = JobRecord(job.name, shown, key, "begun")
        write_record(place, begun)
        record = _processed(job, options, engine, begun, lock)
        write_record(place, record)
        return record


def _processed(job: BatchJob, options: BatchOptions, engine: Engine, begun: JobRecord, lock: int) -> JobRecord:
    target = options.out / f"{job.name}.mcap"
    target.parent.mkdir(parents=True, exist_ok=True)
    outputs = [(option, target.with_name(target.stem + ending)) for option, ending in options.outputs]
    inputs = [getattr(one, "url", str(one)) for one in job.inputs]
    arguments = [*inputs, str(target), *options.arguments, "--quiet", *["--overwrite"] * options.overwrite]
    arguments += [text for option, path in outputs for text in (option, str(path))]
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
    written = [target, *(path for _, path in outputs)]
    sizes = {path.relative_to(options.out).as_posix(): path.stat().st_size for path in written if path.is_file()}
    return replace(record, outputs=sizes)


@contextmanager
def _locked(path: Path) -> Iterator[int | None]:
    """A descriptor that holds the lock; None where another process has it. A process that inherits it keeps it."""
    with path.open("ab") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            yield None
        else:
            yield file.fileno()
