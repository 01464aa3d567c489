"""The command `lidcam report`."""

from pathlib import Path
from typing import Annotated

import typer

from lidcam.cli.options import Overwrite, output_option, with_log_options
from lidcam.cli.printing.log import remark_log
from lidcam.cli.verdict import Verdict

REPORT_EXAMPLES = """\b
Examples:
  lidcam report out.mcap
  lidcam report out.mcap --out drive.html
"""


@with_log_options
def report(
    result: Annotated[Path, typer.Argument(metavar="RESULT.mcap", help="What `lidcam process` wrote.")],
    out: Annotated[Path | None, output_option("The page. Default: beside the result.", ".html")] = None,
    overwrite: Overwrite = False,
) -> None:
    """Write a page about a result.

    One file that opens in any browser, offline. `lidcam process --report OUT.html` writes the same.
    """
    from lidcam.cli.printing.progress import show_progress
    from lidcam.outputs.report.make import write_page

    page = out or result.with_suffix(".html")
    incomplete = write_page(result, page, overwrite=overwrite, show=show_progress)
    remark_log.info("wrote %s", page)
    Verdict((), incomplete).end()
