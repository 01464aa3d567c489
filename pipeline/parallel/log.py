"""The log of several processes: what the others log is shown by the one that has configured logging."""

import logging
from collections.abc import Mapping
from logging.handlers import QueueHandler
from queue import SimpleQueue

__all__ = ["forget_log", "gather_log", "log_levels"]


def log_levels() -> Mapping[str, int]:
    """The levels of the loggers that have one, by name; the root has none."""
    root = logging.getLogger()
    named = {
        name: logger.level for name, logger in root.manager.loggerDict.items() if isinstance(logger, logging.Logger)
    }
    return {"": root.level, **{name: level for name, level in sorted(named.items()) if level != logging.NOTSET}}


def gather_log(levels: Mapping[str, int]) -> SimpleQueue[logging.LogRecord]:
    """Keep what is logged from now on, at the levels of the process that will show it."""
    records: SimpleQueue[logging.LogRecord] = SimpleQueue()
    logging.getLogger().addHandler(QueueHandler(records))
    for name, level in levels.items():
        logging.getLogger(name or None).setLevel(level)
    return records


def forget_log() -> None:
    """Undo the configuration of logging that a copy of a process has."""
    root = logging.getLogger()
    named = [logger for logger in root.manager.loggerDict.values() if isinstance(logger, logging.Logger)]
    for logger in (root, *named):
        logger.handlers.clear()
        logger.filters.clear()
        logger.propagate, logger.disabled = True, False
