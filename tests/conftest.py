"""What holds for all tests: no deadlines, since the machine may be busy; no networks of the user; what saves time."""

import gc
import os
import tempfile

from hypothesis import settings

settings.register_profile("lidcam", deadline=None, max_examples=50)
settings.load_profile("lidcam")

gc.disable()

os.environ["XDG_DATA_HOME"] = f"{tempfile.gettempdir()}/lidcam-tests-have-fetched-nothing"


def pytest_collection_finish() -> None:
    """Look for garbage only in what comes after: thousands of tests and all libraries stay to the end."""
    gc.collect()
    gc.freeze()
    gc.enable()


def pytest_sessionfinish() -> None:
    """At the end everything goes in order."""
    gc.unfreeze()
