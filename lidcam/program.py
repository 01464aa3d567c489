"""Running a program: known errors become one line and an exit code; the only place that exits.

Exit codes: 0 done; 1 the input, the calibration or a check failed, with one line on stderr; 2 wrong usage; anything
else is a bug and shows its traceback. Results go to stdout, progress and log to stderr.
"""

import errno
import logging
import signal
import sys
from collections.abc import Callable
from types import FrameType

from pipeline.core.errors import LidcamError

__all__ = ["run_program"]


def run_program(program: Callable[..., object], name: str) -> None:
    """Run a program with the arguments of the command line; known errors become one line and exit code 1."""
    logging.basicConfig(level=logging.WARNING, format="lidcam: %(message)s", stream=sys.stderr)
    signal.signal(signal.SIGTERM, _terminate)
    try:
        program(sys.argv[1:], prog_name=name)
    except OSError as err:
        if err.errno != errno.ENOSPC:
            raise
        sys.stderr.write(f"lidcam: error: {err.filename or 'standard output'}: {err.strerror}\n")
        sys.exit(1)
    except LidcamError as err:
        sys.stderr.write(f"lidcam: error: {' '.join(str(err).split())}\n")
        for note in getattr(err, "__notes__", ()):
            sys.stderr.write(f"  {note}\n")
        sys.exit(1)


def _terminate(number: int, _: FrameType | None) -> None:
    """Exit through the `finally` blocks, which remove unfinished outputs, with the exit code that shells use."""
    sys.exit(128 + number)
