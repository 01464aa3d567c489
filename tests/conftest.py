"""What holds for all tests: no deadlines, since the machine may be busy with other tests; and less is traced."""

import pytest
from hypothesis import settings
from less_tracing import LessTracing

settings.register_profile("lidcam", deadline=None)
settings.load_profile("lidcam")


def pytest_configure(config: pytest.Config) -> None:
    """Trace less where coverage is counted."""
    config.pluginmanager.register(LessTracing())
