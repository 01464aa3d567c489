"""Running a program: known errors become one line and an exit code; the only place that exits.

Exit codes: 0 done; 1 the input, the calibration or a check failed, with one line on stderr; 2 wrong usage; 128+N ended
by signal N, see `lidcam.start.signals`; anything else is a bug and shows its traceback. Results go to stdout, progress
and log to stderr.
"""

import errno
import logging
import sys
from collections.abc import Callable
from typing import NoReturn

from lidcam.printing.log import configure_logging
from pipeline.core.errors import LidcamError

__all__ = ["run_program"]

logger = logging.getLogger(__name__)

NO_PLACE = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO}
"""Why a disk, or what stdout leads to, takes no more."""


def run_program(program: Callable[..., object], name: str) -> None:
    """Run a program with the arguments of the command line; known errors become one line and exit code 1."""
    configure_logging()
    try:
        program(sys.argv[1:], prog_name=name)
    except OSError as err:
        if err.errno not in NO_PLACE:
            logger.debug("a bug", exc_info=True)
            raise
        _fail(f"{err.filename or 'standard output'}: {err.strerror}")
    except LidcamError as err:
        notes = "".join(f" ({note})" for note in getattr(err, "__notes__", ()))
        _fail(" ".join(str(err).split()) + notes)
    except Exception:
        logger.debug("a bug", exc_info=True)  # for the log file: the interpreter prints the traceback
        raise


def _fail(message: str) -> NoReturn:
    logger.error(message)
    sys.exit(1)
