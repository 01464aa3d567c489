"""The command `lidcam report`."""

from pathlib import Path
from typing import Annotated

import typer

from lidcam.cli.options import Overwrite, output_option, with_log_options
from lidcam.cli.printing.log import remark_log

# \b keeps the lines of a paragraph as they are.
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
    from lidcam.outputs.allowed import PAGE, check_no_input, check_replaced
    from lidcam.outputs.report.make import film_of, make_page
    from lidcam.writers.outputs.transaction import OutputTransaction

    page = out or result.with_suffix(".html")
    check_no_input([page], [result])
    with OutputTransaction([page], check_old=check_replaced(lambda _: PAGE, overwrite=overwrite)) as outputs:
        outputs[page].write_text(make_page(result, show_progress, film=film_of(result, page)))
    remark_log.info("wrote %s", page)
