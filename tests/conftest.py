"""What holds for all tests: no deadlines, since the machine may be busy with other tests; and what saves time."""

import gc

from hypothesis import settings

settings.register_profile("lidcam", deadline=None, max_examples=50)
settings.load_profile("lidcam")


def pytest_collection_finish() -> None:
    """Look for garbage only in what comes after: thousands of tests and all libraries stay to the end."""
    gc.collect()
    gc.freeze()


def pytest_sessionfinish() -> None:
    """At the end everything goes in order."""
    gc.unfreeze()
