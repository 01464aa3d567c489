"""Work on a thread in the background: in order, bounded, and with its errors raised in the foreground."""

import threading
from collections import deque
from collections.abc import Callable


class Background:
    """Does jobs one after another on a thread of its own, which starts with the first of them.

    An error of a job ends the work; the next `add_job` or `finish` raises it.

    Args:
        weight: Largest weight of the jobs that wait; a heavier one waits alone.
        name: Name of the thread.
    """

    def __init__(self, weight: float, name: str) -> None:
        self._limit, self._name = weight, name
        self._jobs: deque[tuple[Callable[[], object], int]] = deque()
        self._left = self._weight = 0  # jobs that wait and the one in work, and their weight
        self._changed = threading.Condition()
        self._error: BaseException | None = None
        self._is_closed = False
        self._thread: threading.Thread | None = None

    def add_job(self, job: Callable[[], object], weight: int) -> None:
        """Have a job done, after those before it; waits while too much is to be done.

        Raises:
            RuntimeError: there is no memory for a thread.
            BaseException: the error of an earlier job.
        """
        if self._thread is None:
            thread = threading.Thread(target=self._work, name=self._name, daemon=True)
            thread.start()
            self._thread = thread
        with self._changed:
            self._changed.wait_for(lambda: self._error or not self._left or self._weight + weight <= self._limit)
            self._check()
            self._jobs.append((job, weight))
            self._left += 1
            self._weight += weight
            self._changed.notify_all()

    def finish(self) -> None:
        """Wait until all jobs are done.

        Raises:
            BaseException: the error of a job.
        """
        with self._changed:
            self._changed.wait_for(lambda: self._error or not self._left)
            self._check()

    def close(self) -> None:
        """End the thread; jobs that wait are not done. When it returns, no job is in work."""
        with self._changed:
            self._is_closed = True
            self._changed.notify_all()
        if self._thread is not None:
            self._thread.join()
        self._jobs.clear()

    def _check(self) -> None:
        if self._error is not None:
            raise self._error

    def _work(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._jobs or self._is_closed)
                if self._is_closed:
                    return
                job, weight = self._jobs.popleft()
            try:
                job()
            except BaseException as err:
                self._error = err
            del job
            with self._changed:
                self._left -= 1
                self._weight -= weight
                self._changed.notify_all()
            if self._error is not None:
                return
