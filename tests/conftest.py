"""What holds for all tests: no deadlines, since the machine may be busy with other tests; and what saves time."""

import gc

import pytest
from hypothesis import settings
from less_tracing import LessTracing

settings.register_profile("lidcam", deadline=None, max_examples=50)
settings.load_profile("lidcam")


def pytest_configure(config: pytest.Config) -> None:
    """Trace less where coverage is counted."""
    config.pluginmanager.register(LessTracing())


def pytest_collection_finish() -> None:
    """Look for garbage only in what comes after: thousands of tests and all libraries stay to the end."""
    gc.collect()
    gc.freeze()


def pytest_sessionfinish() -> None:
    """At the end everything goes in order."""
    gc.unfreeze()
