"""A batch from its arguments to its table: what the command line and `lidcam.batch` do."""

import logging
import subprocess
import sys
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Literal, Unpack

from lidcam.batches.index import index_of, keep_index
from lidcam.batches.jobs import INDEX, BatchJob, find_jobs
from lidcam.batches.local import LocalEngine, jobs_that_fit
from lidcam.batches.ray import RayEngine
from lidcam.batches.records import JobRecord, totals_line
from lidcam.batches.result import BatchResult
from lidcam.batches.run import MATCHES, BatchOptions, run_batch
from lidcam.batches.store import Store
from lidcam.batches.table import TABLE, records_table
from lidcam.outputs.registry import endings_of
from lidcam.pipeline.core.errors import ConfigError
from lidcam.pipeline.parallel.cores import usable_cores
from lidcam.readers.location import Location
from lidcam.run.job import make_job
from lidcam.run.options import SharedOptions

logger = logging.getLogger(__name__)

COMPILE = "import lidcam.processing"
"""Run once, before many processes begin, in a process of its own, so that this one stays small."""

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
    save_matches: bool = False,
    overwrite: bool = False,
    fail_fast: bool = False,
    watch: WatchBatch = not_watched,
    **options: Unpack[SharedOptions],
) -> BatchResult:
    """Process many recordings, as `lidcam.batch` says.

    Args:
        recordings: Recordings, folders, patterns, URLs, `@list.txt`.
        out: Folder of the results.
        jobs: Recordings at once.
        engine: Processes on this machine, or tasks of Ray.
        address: Of a Ray cluster.
        outputs: Options of `lidcam process` that name further outputs, `--rerun`.
        save_matches: Whether images of matches are written.
        overwrite: Whether results that are up to date are made anew.
        fail_fast: Whether nothing else is started after a failure.
        watch: Shows the progress.
        **options: As in `lidcam.process`.

    Raises:
        LidcamError: the settings, the rig or an output is at fault, or there are no recordings.
    """
    if unknown := options.keys() - SharedOptions.__annotations__.keys():
        raise TypeError(f"expected options of lidcam.batch, got {', '.join(unknown)}")
    if address is not None and engine != "ray":
        raise ConfigError("address: expected the engine ray with it")
    if save_matches and not isinstance(out, Path):
        raise ConfigError("save_matches: images are written to a local folder")
    found = find_jobs(recordings, out)
    at_once = min(jobs or jobs_that_fit(len(found)), len(found))
    cores = options.get("workers") or (1 if address else max(usable_cores() // at_once, 1))
    options["workers"] = cores
    job = make_job((), overwrite=overwrite, **options)  # settings, rig and network are checked once
    endings = [*(endings_of(option)[0] for option in outputs), *([MATCHES] if save_matches else [])]
    store = Store(out)
    subprocess.run([sys.executable, "-c", COMPILE], check=False)
    runs = RayEngine(jobs if address else at_once, cores, address) if engine == "ray" else LocalEngine(at_once)
    with watch(found) as told:
        records = run_batch(found, BatchOptions(out, job, endings, fail_fast=fail_fast), runs, told)
    store.keep_table(records_table(records))
    if not keep_index(index_of(records, totals_line(records), store), store):
        logger.warning("%s/%s was not written by lidcam: it stays as it is", str(out).rstrip("/"), INDEX)
    return BatchResult(tuple(records), len(found), f"{str(out).rstrip('/')}/{TABLE}")
