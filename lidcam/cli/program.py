"""Running a program: known errors become one line and an exit code; the only place that exits.

Exit codes: 0 done; 1 failed, with one line on stderr, and nothing was written, or checks failed, with a line each, and
the outputs are kept; 2 wrong usage; 3 done, but part of the recording could not be used, as the last line on stderr
says; 128 + N ended by signal N, see `lidcam.signals`. Anything else is a bug and shows its traceback. Results go to
stdout, progress and log to stderr.
"""

import gc
import io
import logging
import os
import re
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import NoReturn

from typer.exceptions import TyperException

from lidcam.cli.printing.escaping import visible, visible_lines
from lidcam.cli.printing.log import configure_logging, verdict_log
from lidcam.cli.verdict import FAILED, INCOMPLETE
from lidcam.pipeline.core.errors import CheckError, IncompleteError, short_memory_told
from lidcam.run.warning import error_line

logger = logging.getLogger(__name__)

GARBAGE_AFTER = 10_000
"""New objects between searches for garbage; Python's default of 700 costs a tenth of the start."""


def run_program(program: Callable[..., object], name: str) -> None:
    """Run a program with the arguments of the command line; known errors become one line and an exit code."""
    gc.set_threshold(GARBAGE_AFTER)
    os.environ["PYTHONSAFEPATH"] = "1"  # processes that it starts take no code from the folder it runs in
    configure_logging()
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # a terminal that knows fewer letters than a name has
    try:
        with short_memory_told("go on"):
            code = program(sys.argv[1:], prog_name=name, standalone_mode=False)
    except IncompleteError as err:
        verdict_log.warning("incomplete: %s; exit code %d", err, INCOMPLETE)
        sys.exit(INCOMPLETE)
    except CheckError as err:
        _fail(*err.lines)
    except TyperException as err:
        _print_usage_error(err)
        sys.exit(err.exit_code)
    except Exception as err:
        if line := error_line(err):
            _fail(line)
        logger.debug("a bug", exc_info=True)  # for the log file: the interpreter prints the traceback
        raise
    if isinstance(code, int):  # that of Ctrl-C, of --version and --help
        sys.exit(code)


def _fail(*lines: str) -> NoReturn:
    for line in lines:
        logger.error("%s", line)
    sys.exit(FAILED)


PHRASES = {
    r"Value error, (.*) is not one of (.*)\.$": r"expected one of \2, found \1",
    r"Input should be greater than or equal to (\S+)": r"expected at least \1",
    r"Input should be a valid integer.*": "expected a whole number",
    r"Input should be a valid number.*": "expected a number",
    r"No such option: --(topics?|lidars?|cameras?)\b.*": (
        "No such option: --set 'topics.lidars=[/points]' chooses topics of sensors, --copy-topics names others to copy"
    ),
    r"No such option: --(output|outdir|output-dir)\b.*": "No such option: -o DIR|FILE names the output",
    r"\s*Choose from:\s*": " Choose from: ",
    r",\n\t": ", ",
}
"""Messages of the parser of the command line, and what users read in their place."""


def _print_usage_error(error: TyperException) -> None:
    """Print the usage of a command and what is wrong with its arguments, which are quoted and made visible."""
    message = error.format_message()
    for pattern, words in PHRASES.items():
        message = re.sub(pattern, words, message)
    if file := next((one for one in sys.argv[1:] if one[:1] == "-" and Path(one).is_file()), ""):
        message = f"{message.rstrip('.')}. There is a file {file}: write ./{file}"
    if not message.startswith("Usage: "):  # the whole help, where a command without arguments prints that
        vars(error)["format_message"] = lambda: visible(message)
    text = io.StringIO()
    error.show(text)  # type: ignore[attr-defined]  # of all that Typer raises
    with suppress(OSError):  # nobody reads it
        sys.stderr.write(visible_lines(text.getvalue()))
