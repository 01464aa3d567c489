"""The command `lidcam batch`."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Literal, Unpack

import typer

from lidcam.cli.options import AsJson, option, with_job_options, with_log_options
from lidcam.cli.printing.log import is_verbose, remark_log
from lidcam.cli.verdict import Verdict
from lidcam.readers.location import location
from lidcam.run.options import SharedOptions

if TYPE_CHECKING:
    from lidcam.batches.records import JobRecord

BATCH_EXAMPLES = """\
Exit codes: 0 all done; 3 part of a recording could not be used; 1 a recording
failed; 2 wrong usage. If one recording fails, the others go on.

\b
Examples:
  lidcam batch bag_folder --out results
  lidcam batch drive.bag bag_folder --out results --jobs 2 --objects --report
"""


@with_log_options
@with_job_options(*SharedOptions.__annotations__)
def batch(
    recordings: Annotated[
        list[str],
        typer.Argument(
            metavar="IN [IN ...]",
            help="Recordings, folders (also s3://bucket/folder), patterns ('logs/*.bag'), URLs, or @LIST.txt with one "
            "per line.",
        ),
    ],
    out: Annotated[str, option("Folder for the results; may be s3://bucket/folder.", "--out", "-o", metavar="DIR")],
    jobs: Annotated[
        int | None, option("Recordings at once. Default: as many as cores and memory allow.", metavar="N", min=1)
    ] = None,
    engine: Annotated[
        Literal["local", "ray"], option("Processes on this machine, or Ray tasks (extra ray).")
    ] = "local",
    address: Annotated[
        str | None, option("Ray cluster address, or `auto`. Default: start Ray on this machine.", metavar="HOST:PORT")
    ] = None,
    rerun: Annotated[bool, option("Also write Rerun recordings.", "--rerun")] = False,
    report: Annotated[bool, option("Also write pages about the results.", "--report")] = False,
    objects: Annotated[bool, option("Also write Parquet tables of the objects.", "--objects")] = False,
    video: Annotated[bool, option("Also write films (extra video).", "--video")] = False,
    reprocess: Annotated[
        bool, option("Reprocess results that are up to date, and overwrite other files.", "--overwrite")
    ] = False,
    as_json: AsJson = False,
    **options: Unpack[SharedOptions],
) -> None:
    """Process many recordings: one result each, and a summary table.

    Re-running processes only what is missing or changed: recording, settings, rig, network or version.
    """
    from dataclasses import asdict

    from lidcam.batches.jobs import INDEX
    from lidcam.batches.run import process_batch
    from lidcam.cli.printing.batch import print_batch, shown_batch
    from lidcam.cli.printing.terminal import console, show_json

    if address is not None and engine != "ray":
        raise typer.BadParameter("expected --engine ray with it", param_hint="--address")
    done = process_batch(
        recordings,
        location(out),
        jobs=jobs,
        engine=engine,
        address=address,
        outputs={"--rerun": rerun, "--report": report, "--objects": objects, "--video": video},
        overwrite=reprocess,
        watch=shown_batch,
        **options,
    )
    if as_json:
        show_json(console(), {"jobs": [asdict(record) for record in done.records]})
    else:
        print_batch(console(), done.records, everything=is_verbose())
    remark_log.info("wrote %s, and %s to look at", done.table, INDEX)
    _verdict(done.records).end()


def _verdict(records: "Sequence[JobRecord]") -> Verdict:
    failed = [record for record in records if record.state == "failed"]
    others = [f"{record.name}: {record.message}" for record in records if record.state in {"incomplete", "busy"}]
    if not failed:
        return Verdict((), others)
    more = f", and {len(failed) - 1} more" if len(failed) > 1 else ""
    return Verdict((f"{len(failed)} of {len(records)} recordings failed: {failed[0].name}: {failed[0].message}{more}",))
