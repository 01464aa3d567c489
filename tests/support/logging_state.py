"""Keeping what a program does to logging within a test."""

import logging
from collections.abc import Iterator
from contextlib import contextmanager

from lidcam.cli.printing.log import progress_log, remark_log

NAMES = ("lidcam", progress_log.name, remark_log.name)


@contextmanager
def kept_logging() -> Iterator[None]:
    """Handlers and levels are put back as they were; inside there are no handlers but those that are made there."""
    root = logging.getLogger()
    handlers, level = root.handlers, root.level
    levels = {name: logging.getLogger(name).level for name in NAMES}
    root.handlers = []
    try:
        yield
    finally:
        for handler in root.handlers:
            handler.close()
        root.handlers, root.level = handlers, level
        for name, before in levels.items():
            logging.getLogger(name).setLevel(before)
