"""Running a program: known errors become one line and an exit code; the only place that exits.

Exit codes: 0 done, and nothing that was asked for is missing; 1 failed, with one line on stderr: nothing was written,
or checks failed, with a line each, and the outputs are there; 2 wrong usage; 3 done, the outputs are complete, but part
of the recording could not be used: the last line on stderr says what; 128 + N ended by signal N, see
`lidcam.__main__`; anything else is a bug and shows its traceback. Results go to stdout, progress and log to
stderr.
"""

import errno
import gc
import io
import logging
import sys
from collections.abc import Callable
from contextlib import suppress
from typing import NoReturn

from typer.exceptions import TyperException

from lidcam.cli.printing.escaping import visible, visible_lines
from lidcam.cli.printing.log import configure_logging, verdict_log
from lidcam.cli.verdict import FAILED, INCOMPLETE
from lidcam.pipeline.core.errors import CheckError, IncompleteError, LidcamError, short_memory_told
from lidcam.pipeline.core.text import one_line

logger = logging.getLogger(__name__)

NO_PLACE = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO}
"""Why a disk, or what stdout leads to, takes no more."""

FORBIDDEN = {errno.EACCES, errno.EPERM, errno.EROFS}
"""Why this user may not do what was asked with a file."""

GARBAGE_AFTER = 10_000
"""New objects after which Python looks for garbage; its own 700 takes a tenth of a start, which makes none."""


def run_program(program: Callable[..., object], name: str) -> None:
    """Run a program with the arguments of the command line; known errors become one line and an exit code."""
    gc.set_threshold(GARBAGE_AFTER)
    configure_logging()
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # a terminal that knows fewer letters than a name has
    try:
        with short_memory_told("go on"):
            code = program(sys.argv[1:], prog_name=name, standalone_mode=False)
    except OSError as err:
        if err.errno == errno.ENOENT and err.filename is None:
            _fail("the folder that this was started in is gone: change to another one")
        if err.errno not in NO_PLACE and (err.errno not in FORBIDDEN or err.filename is None):
            logger.debug("a bug", exc_info=True)
            raise
        _fail(f"{err.filename or 'standard output'}: {err.strerror}")
    except IncompleteError as err:
        verdict_log.warning("incomplete: %s; exit code %d", err, INCOMPLETE)
        sys.exit(INCOMPLETE)
    except CheckError as err:
        _fail(*err.lines)
    except LidcamError as err:
        notes = "".join(f" ({note})" for note in getattr(err, "__notes__", ()))
        _fail(one_line(err) + notes)
    except TyperException as err:
        _print_usage_error(err)
        sys.exit(err.exit_code)
    except Exception:
        logger.debug("a bug", exc_info=True)  # for the log file: the interpreter prints the traceback
        raise
    if isinstance(code, int):  # that of Ctrl-C, of --version and --help
        sys.exit(code)


def _fail(*lines: str) -> NoReturn:
    for line in lines:
        logger.error("%s", line)
    sys.exit(FAILED)


def _print_usage_error(error: TyperException) -> None:
    """Print the usage of a command and what is wrong with its arguments, which are quoted and made visible."""
    message = error.format_message()
    if not message.startswith("Usage: "):  # the whole help, where a command without arguments prints that
        vars(error)["format_message"] = lambda: visible(message)
    text = io.StringIO()
    error.show(text)  # type: ignore[attr-defined]  # of all that Typer raises
    with suppress(OSError):  # nobody reads it
        sys.stderr.write(visible_lines(text.getvalue()))
