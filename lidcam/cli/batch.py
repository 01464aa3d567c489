"""The command `lidcam batch`."""

import subprocess
import sys
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from lidcam.cli.options import (
    AsJson,
    ConfigFile,
    CopyTopics,
    Duration,
    Every,
    Model2d,
    Model3d,
    OnBad,
    RigFile,
    Setting,
    Start,
    Workers,
    with_log_options,
)
from lidcam.cli.printing.log import remark_log
from lidcam.cli.verdict import Verdict
from lidcam.readers.location import location

if TYPE_CHECKING:
    from lidcam.batch.engine import Engine
    from lidcam.batch.records import JobRecord

# \b keeps the lines of a paragraph as they are.
BATCH_EXAMPLES = """\b
Exit codes: 0 all done; 3 part of a recording could not be used; 1 a recording
failed; 2 wrong usage. A recording that fails stops no other.

\b
Examples:
  lidcam batch bag_folder --out results
  lidcam batch drive.bag bag_folder --out results --jobs 2 --objects --report
"""


COMPILE = """
from lidcam.cli.printing.compiling import compiled_together
with compiled_together(shown=True):
    import lidcam.processing
"""
"""In a process of its own, so that this one stays small: once, before many processes begin."""

FOLDER_END = "_matches"
"""End of the name of a folder of pictures, which has no ending."""


@with_log_options
def batch(
    recordings: Annotated[
        list[str],
        typer.Argument(
            metavar="IN [IN ...]",
            help="Recordings, folders of them (s3://bucket/folder, too), patterns ('logs/*.bag'), URLs, @LIST.txt with "
            "one in a line.",
        ),
    ],
    out: Annotated[str, typer.Option("--out", metavar="DIR", help="Folder of the results, also s3://bucket/folder.")],
    jobs: Annotated[
        int | None,
        typer.Option(
            min=1, metavar="N", help="Recordings at once; without it, as many as cores and memory have room for."
        ),
    ] = None,
    engine: Annotated[
        Literal["local", "ray"], typer.Option(help="Processes of this machine, or tasks of Ray (extra ray).")
    ] = "local",
    address: Annotated[
        str | None,
        typer.Option(
            metavar="HOST:PORT", help="Of a Ray cluster, or `auto`; without it, Ray is started on this machine."
        ),
    ] = None,
    rerun: Annotated[bool, typer.Option("--rerun", help="Also write a Rerun recording of each.")] = False,
    report: Annotated[bool, typer.Option("--report", help="Also write a page about each.")] = False,
    objects: Annotated[
        bool, typer.Option("--objects", help="Also write a Parquet table of the objects of each.")
    ] = False,
    video: Annotated[bool, typer.Option("--video", help="Also write a film of each (extra video).")] = False,
    save_matches: Annotated[
        bool, typer.Option("--save-matches", help="Also write a folder of pictures of each camera and frame.")
    ] = False,
    config_file: ConfigFile = None,
    settings: Setting = None,
    rig_files: RigFile = None,
    model_2d: Model2d = None,
    model_3d: Model3d = None,
    start: Start = 0.0,
    duration_s: Duration = None,
    every: Every = None,
    workers: Workers = None,
    on_bad_message: OnBad = "skip",
    copy_topics: CopyTopics = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Process again what is current, too.")] = False,
    fail_fast: Annotated[
        bool, typer.Option("--fail-fast", help="Begin no other recording after one that failed.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Process many recordings: one result each, and a table of all.

    A second run does what is missing: a result stays as long as recording, settings, rig, network and version are the
    same.
    """
    from dataclasses import asdict

    from lidcam.batch.jobs import find_jobs
    from lidcam.batch.local import jobs_that_fit
    from lidcam.batch.run import BatchOptions, run_batch
    from lidcam.batch.store import open_store
    from lidcam.batch.table import TABLE, table_of
    from lidcam.cli.printing.batch import print_batch, shown_batch
    from lidcam.cli.printing.terminal import console, show_json
    from lidcam.outputs.registry import endings_of
    from lidcam.pipeline.parallel.cores import usable_cores
    from lidcam.run.job import make_job

    if address is not None and engine != "ray":
        raise typer.BadParameter("expected --engine ray with it", param_hint="--address")
    place = location(out)
    if save_matches and not isinstance(place, Path):
        raise typer.BadParameter("pictures are written to a local folder", param_hint="--save-matches")
    found = find_jobs(recordings, place)
    # Settings, rig and network are checked once, before any recording is read.
    first = make_job(
        found[0].inputs,
        config=config_file,
        settings=settings or (),
        rig=rig_files,
        model_2d=model_2d,
        model_3d=model_3d,
        copy_topics=copy_topics or None,
        workers=workers,
        start_s=start,
        duration_s=duration_s,
        every=every,
        on_bad_message=on_bad_message,
    )
    store = open_store(place)
    given = [
        ("--config", config_file),
        ("--model-2d", model_2d),
        ("--model-3d", model_3d),
        ("--duration", duration_s),
        ("--start", start),
        ("--every", every),
    ]
    arguments = [text for name, value in given if value for text in (name, str(value))]
    many = [("--set", settings), ("--rig", rig_files), ("--copy-topics", copy_topics)]
    arguments += [text for name, values in many for value in values or () for text in (name, value)]
    arguments += ["--on-bad-message", on_bad_message]
    switches = {"--rerun": rerun, "--report": report, "--objects": objects, "--video": video}
    switches["--save-matches"] = save_matches
    outputs = [(option, endings_of(option)[0] or FOLDER_END) for option, wanted in switches.items() if wanted]
    files = [sha256(path.read_bytes()).hexdigest() for path in first.read_files]
    at_once = min(jobs or jobs_that_fit(len(found)), len(found))
    cores = workers or (1 if address else max(usable_cores() // at_once, 1))
    options = BatchOptions(
        place,
        [*arguments, "--workers", str(cores)],
        outputs,
        facts=[_version(), *arguments, *(option for option, _ in outputs), *files],
        overwrite=overwrite,
        fail_fast=fail_fast,
    )
    subprocess.run([sys.executable, "-c", COMPILE], check=False)
    with shown_batch(found) as told:
        records = run_batch(found, options, _engine(engine, jobs if address else at_once, cores, address), told)
    store.write(TABLE, table_of(records))
    if as_json:
        show_json(console(), {"jobs": [asdict(record) for record in records]})
    else:
        print_batch(console(), records)
    remark_log.info("wrote %s/%s", str(place).rstrip("/"), TABLE)
    _verdict(records, len(found)).end()


def _engine(name: str, jobs: int | None, cores: int, address: str | None) -> "Engine":
    from lidcam.batch.local import LocalEngine
    from lidcam.batch.ray import RayEngine

    return RayEngine(jobs, cores, address) if name == "ray" else LocalEngine(jobs or 1)


def _version() -> str:
    from importlib.metadata import version

    return version("lidcam")


def _verdict(records: "list[JobRecord]", count: int) -> Verdict:
    failed = [record for record in records if record.state == "failed"]
    others = [f"{record.name}: {record.message}" for record in records if record.state in {"incomplete", "busy"}]
    if not failed:
        return Verdict((), others)
    left = f"; {count - len(records)} were not begun" if count > len(records) else ""
    more = f", and {len(failed) - 1} more" if len(failed) > 1 else ""
    return Verdict((f"{len(failed)} of {count} recordings failed: {failed[0].name}: {failed[0].message}{more}{left}",))
