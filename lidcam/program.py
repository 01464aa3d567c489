"""Running a program: known errors become one line and an exit code; the only place that exits.

Exit codes: 0 done, and nothing that was asked for is missing; 1 failed, with one line on stderr: nothing was written,
or a check failed and the outputs are there; 2 wrong usage; 3 done, the outputs are complete, but part of the recording
could not be used: the last line on stderr says what; 128 + N ended by signal N; anything else is a bug and shows its
traceback. Results go to stdout, progress and log to stderr.
"""

import errno
import logging
import signal
import sys
from collections.abc import Callable, Sequence
from types import FrameType
from typing import NoReturn

from lidcam.commands.verdict import FAILED, INCOMPLETE
from lidcam.printing.log import configure_logging, verdict_log
from pipeline.core.errors import IncompleteError, LidcamError

__all__ = ["run_program"]

logger = logging.getLogger(__name__)


def run_program(program: Callable[..., object], name: str) -> None:
    """Run a program with the arguments of the command line; known errors become one line and an exit code."""
    configure_logging()
    signal.signal(signal.SIGTERM, _terminate)
    try:
        program(sys.argv[1:], prog_name=name)
    except OSError as err:
        if err.errno != errno.ENOSPC:
            logger.debug("a bug", exc_info=True)
            raise
        _fail(f"{err.filename or 'standard output'}: {err.strerror}")
    except IncompleteError as err:
        verdict_log.warning("incomplete: %s; exit code %d", err, INCOMPLETE)
        sys.exit(INCOMPLETE)
    except LidcamError as err:
        _fail(" ".join(str(err).split()), getattr(err, "__notes__", ()))
    except Exception:
        logger.debug("a bug", exc_info=True)  # for the log file: the interpreter prints the traceback
        raise


def _fail(message: str, notes: Sequence[str] = ()) -> NoReturn:
    logger.error("%s", message, extra={"notes": notes})
    sys.exit(FAILED)


def _terminate(number: int, _: FrameType | None) -> None:
    """Exit through the `finally` blocks, which remove unfinished outputs, with the exit code that shells use."""
    sys.exit(128 + number)
