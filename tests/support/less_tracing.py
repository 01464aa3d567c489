"""Coverage where it tells something new: what is traced takes almost twice the time, libraries and imports as well.

- A property is traced in its first examples, which run what there is to run; the others look for values that fail.
- What is measured, and what does the same for long, is not traced.
- Processes that tests start are traced where the test has the mark `traced_processes`; elsewhere they run lines that
  tests within this process count, too, and each of them would write all that it counted to a file of its own.
"""

import os
import sys
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager
from typing import Any

import pytest

TRACED_EXAMPLES = 10
"""Of each property."""

PROCESSES = "COVERAGE_PROCESS_CONFIG"
"""The variable that makes processes trace what they run."""


class LessTracing:
    """A plugin of pytest that does nothing where nothing is traced."""

    def __init__(self) -> None:
        self._settings: str | None = None

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_setup(self, item: pytest.Item) -> None:
        """Have processes traced, or not."""
        self._settings = os.environ.pop(PROCESSES, None) or self._settings
        if self._settings and item.get_closest_marker("traced_processes"):
            os.environ[PROCESSES] = self._settings

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_call(self, item: pytest.Item) -> Generator[None, object, object]:
        """Trace the first examples of a property."""
        if item.get_closest_marker("untraced"):
            with untraced():
                return (yield)
        trace, property_ = sys.gettrace(), getattr(getattr(item, "obj", None), "hypothesis", None)
        if trace is None or property_ is None:
            return (yield)
        inner = property_.inner_test
        property_.inner_test = _first_traced(inner)
        try:
            return (yield)
        finally:
            property_.inner_test = inner
            sys.settrace(trace)


@contextmanager
def untraced() -> Iterator[None]:
    """Trace nothing of what this thread does."""
    trace = sys.gettrace()
    sys.settrace(None)
    try:
        yield
    finally:
        sys.settrace(trace)


def _first_traced(inner: Callable[..., Any]) -> Callable[..., Any]:
    count = 0

    def example(*arguments: Any, **named: Any) -> Any:
        nonlocal count
        count += 1
        if count > TRACED_EXAMPLES:
            sys.settrace(None)  # also what draws the examples after this one
        return inner(*arguments, **named)

    return example
