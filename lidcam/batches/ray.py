"""Jobs on a Ray cluster, or on this machine with Ray: one task each, with its cores and memory."""

import logging
import os
import pickle
import secrets
import signal
import socket
from collections.abc import Callable, Generator, Sequence
from contextlib import chdir, redirect_stdout
from dataclasses import replace
from importlib.metadata import version
from io import TextIOBase
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Lock, current_thread, main_thread
from typing import Any, TypeVar

from lidcam.batches.local import JOB_MIB, WORKER, Engine, Task, cancelled
from lidcam.batches.records import JobRecord
from lidcam.pipeline.core.errors import LidcamError, WorkerError

logger = logging.getLogger(__name__)

T = TypeVar("T")

TRIES = 4
"""Attempts at a job whose node died or ran out of memory."""

QUIET = {
    "RAY_USAGE_STATS_ENABLED": "0",
    "RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO": "0",  # a job sees the devices that it sees without Ray
    "RAY_task_oom_retries": str(TRIES - 1),  # without end, else
}

CONNECT_S = 10.0

STORE_BYTES = 100 << 20
"""Memory of Ray's object store, where Ray is started here; the smallest that Ray accepts, since tasks share none."""


class RayEngine(Engine):
    """Runs each job as a task of Ray, with this many cores, at most `jobs` at once; None: as many as have room.

    This process waits for as many tasks as have room, and holds their locks. Ray retries a task if its node died or ran
    out of memory, never because of its recording: a record of a failed job is a result.

    `address` is that of the cluster; None starts Ray on this machine. `program` is as in `LocalEngine`. Raises
    LidcamError if Ray is not installed, there is no cluster, or it has no room for a job.
    """

    def __init__(self, jobs: int | None, cores: int, address: str | None, program: Sequence[str] = WORKER) -> None:
        os.environ.update(QUIET | os.environ | ({} if address else _closed()))
        try:
            import ray
        except ImportError as err:
            raise LidcamError("engine ray needs Ray, which is not installed: pip install 'lidcam[ray]'") from err
        self._ray: Any = ray
        self._program = tuple(program)
        self._lock, self._refs, self._is_ending = Lock(), set[Any](), False
        self._folder = TemporaryDirectory(prefix="ray-", ignore_cleanup_errors=True)
        size: dict[str, Any] = {"num_cpus": (jobs or 1) * cores, "object_store_memory": STORE_BYTES}
        started = {**size, "include_dashboard": False, "_temp_dir": self._folder.name}
        handler = signal.getsignal(signal.SIGTERM)
        try:
            if address:
                _check(address)
            options = {"log_to_driver": False, "logging_level": logging.ERROR} | ({} if address else started)
            with chdir(self._folder.name):  # the nodes take code from the folder that this runs in
                ray.init(address or "local", **options)
        except Exception as err:  # of many kinds: no cluster, another version of Ray or Python
            self._leave()
            raise LidcamError(f"engine ray: {' '.join(str(err).split())}") from err
        finally:
            if current_thread() is main_thread():
                signal.signal(signal.SIGTERM, handler)  # Ray has put its own in its place
        nodes = [node["Resources"] for node in self._ray.nodes() if node["Alive"]]
        room = int(sum(min(one.get("CPU", 0) // cores, one.get("memory", 0) // (JOB_MIB << 20)) for one in nodes))
        if not room:
            self._leave()
            raise LidcamError(f"engine ray: expected a node with {cores} cores and {JOB_MIB} MiB of memory, found none")
        super().__init__(jobs or room)
        self._task = ray.remote(num_cpus=cores, memory=JOB_MIB << 20, max_retries=TRIES - 1, retry_exceptions=False)(
            _task()
        )

    def outcomes(self, tasks: Sequence[Callable[[Engine], T]]) -> Generator[T, None, None]:
        """See `Engine`; then leaves Ray, or stops it if it was started here. What Ray prints is logged."""
        with redirect_stdout(_Logged()):
            try:
                yield from super().outcomes(tasks)
            finally:
                self._leave()

    def run(self, task: Task, *, keep_open: int | None) -> JobRecord:  # noqa: ARG002  # of this machine
        """Run it on a node that has room, and wait for it."""
        errors = self._ray.exceptions
        with self._lock:
            if self._is_ending:
                return cancelled(task)
            ref = self._task.remote(self._program, pickle.dumps(task), str(Path.cwd()), version("lidcam"))
            self._refs.add(ref)
        try:
            record: JobRecord | str = self._ray.get(ref)
        except errors.RayError as err:
            if self._is_ending:
                return cancelled(task)
            line = next(iter(str(err).strip().splitlines()), "")
            message = f"its node died or ran out of memory, {TRIES} times: {line}"
            if isinstance(err, errors.RayTaskError):
                message = str(err).strip().splitlines()[-1]
            return replace(task.record, state="failed", exit_code=1, message=message)
        finally:
            with self._lock:
                self._refs.discard(ref)
        if isinstance(record, str):
            raise WorkerError(record)
        return record

    def _leave(self) -> None:
        self._ray.shutdown()
        self._folder.cleanup()

    def _end(self) -> None:
        with self._lock:
            self._is_ending = True
            for ref in self._refs:
                self._ray.cancel(ref, force=True)


class _Logged(TextIOBase):
    """Logs what Ray prints on stdout, where results are expected."""

    def write(self, text: str, /) -> int:
        for line in text.splitlines():
            logger.info("%s", line)
        return len(text)


def _task() -> Callable[[tuple[str, ...], bytes, str, str], object]:
    """The function that runs on a node; it travels as code, as lidcam may be missing there."""

    def processed(program: tuple[str, ...], task: bytes, folder: str, wanted: str) -> object:
        """The record of the job, or a line about what is wrong with the node."""
        import os
        import pickle
        import socket
        from importlib.metadata import PackageNotFoundError, version

        try:
            found = version("lidcam")
        except PackageNotFoundError:
            found = "none"
        node = f"node {socket.gethostname()}"
        if found != wanted:
            return f"{node}: expected lidcam {wanted}, found {found}: install the same version on all nodes"
        if not os.path.isdir(folder):  # noqa: PTH112  # travels alone, without imports
            return f"{node}: expected the folder {folder}: all nodes read and write the files under the same paths"
        os.chdir(folder)
        from lidcam.batches.local import LocalEngine

        job = pickle.loads(task)  # noqa: S301  # from the batch
        (record,) = LocalEngine(1, program, is_bound=True).outcomes([lambda engine: engine.run(job, keep_open=None)])
        return record

    return processed


def _closed() -> dict[str, str]:
    """Settings of a Ray that is for this program alone; `import ray` reads them."""
    return {
        "RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "0",  # no other machine joins, on no system: it listens at 127.0.0.1
        "RAY_AUTH_MODE": "token",
        "RAY_AUTH_TOKEN": secrets.token_hex(),
    }


def _check(address: str) -> None:
    """Check that a server listens at an address: Ray itself tries for minutes."""
    host, _, port = address.rpartition(":")
    if not host or not port.isdigit() or "//" in host:
        return  # `auto`, a client
    try:
        socket.create_connection((host, int(port)), CONNECT_S).close()
    except OSError as err:
        raise LidcamError(f"{address}: expected the head of a Ray cluster, found none: {err.strerror or err}") from err
