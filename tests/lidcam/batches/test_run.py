"""Batches whose jobs do not take the time of a run; tests/e2e/test_batch.py has those that do."""

import fcntl
import os
import pickle
import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import IO

import pytest
from written_jobs import Written

from lidcam.batches.jobs import RECORDS, BatchJob, find_jobs
from lidcam.batches.local import Engine, LocalEngine, Task
from lidcam.batches.records import JobRecord
from lidcam.batches.run import BatchOptions, run_batch
from lidcam.batches.store import Store
from lidcam.run.job import Job


@pytest.fixture
def jobs(tmp_path: Path) -> list[BatchJob]:
    logs = tmp_path / "logs"
    logs.mkdir()
    for name, content in {"a": b"good", "b": b"bad, and long", "c": b"cut"}.items():
        (logs / f"{name}.bag").write_bytes(content)
    return find_jobs([str(logs)], tmp_path / "out")


@pytest.fixture
def options(tmp_path: Path) -> BatchOptions:
    return BatchOptions(tmp_path / "out", Job(()))


def folder(options: BatchOptions) -> Path:
    assert isinstance(options.out, Path)
    return options.out


def done(jobs: list[BatchJob], options: BatchOptions) -> tuple[list[str], list[str]]:
    """The states, and the recordings that were processed for them."""
    engine = Written()
    records = run_batch(jobs, options, engine, lambda _: None)
    return [record.state for record in records], engine.ran


def test_a_bad_recording_stops_no_other_and_the_longest_is_first(jobs: list[BatchJob], options: BatchOptions) -> None:
    assert done(jobs, options) == (["done", "failed", "incomplete"], ["b.bag", "a.bag", "c.bag"])
    assert sorted(path.name for path in folder(options).glob("*.mcap")) == ["a.mcap", "c.mcap"]


def test_a_second_run_does_what_is_missing(jobs: list[BatchJob], options: BatchOptions) -> None:
    done(jobs, options)
    assert done(jobs, options)[1] == ["b.bag"]
    (folder(options) / "a.mcap").unlink()
    assert done(jobs, options)[1] == ["b.bag", "a.bag"]
    jobs[2].inputs[0].write_bytes(b"cut elsewhere")  # type: ignore[union-attr]  # a path
    assert done(jobs, options)[1] == ["b.bag", "c.bag"]
    changed = replace(options, job=Job((), start_s=1.0))
    assert done(jobs, changed)[1] == ["b.bag", "a.bag", "c.bag"]
    assert done(jobs, replace(changed, job=replace(changed.job, overwrite=True)))[1] == ["b.bag", "a.bag", "c.bag"]


def test_what_was_at_work_when_a_batch_was_killed_is_done_again(
    jobs: list[BatchJob], options: BatchOptions, caplog: pytest.LogCaptureFixture
) -> None:
    done(jobs, options)
    store = Store(options.out)
    record = store.record("a")
    assert record is not None
    store.keep(replace(record, state="begun"))
    assert done(jobs, options)[1] == ["b.bag", "a.bag"]
    assert "a: an earlier batch was killed while it ran" in caplog.text


def test_a_job_at_which_another_batch_is_at_work_is_left_to_it(jobs: list[BatchJob], options: BatchOptions) -> None:
    (folder(options) / RECORDS).mkdir(parents=True)
    with (folder(options) / RECORDS / "a.lock").open("wb") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        assert done(jobs, options) == (["busy", "failed", "incomplete"], ["b.bag", "c.bag"])
        Store(options.out).keep(JobRecord("a", "a.bag", "key", "begun"))
        assert done(jobs, options)[0] == ["busy", "failed", "incomplete"]

        def ready(record: JobRecord) -> None:
            """The other batch ends while this one is at work."""
            if record.name == "a":
                Store(options.out).keep(JobRecord("a", "a.bag", "key", "done", exit_code=0, frames=3))

        (first, *_) = run_batch(jobs, options, Written(), ready)
        assert (first.state, first.frames) == ("done", 3)


@pytest.fixture
def held(tmp_path: Path) -> Iterator[int]:
    with (tmp_path / "held").open("wb") as file:
        yield file.fileno()


TASK = Task(JobRecord("a", "a.bag", "key", "begun"), Job((Path("none.bag"),)), ())


def program(code: str) -> tuple[str, str]:
    """Runs this for each job."""
    return "-c", f"import os\nfrom lidcam.batches.worker import serve\ndef job(task): {code}\nserve(job)"


def records(code: str, *, count: int = 1, keep_open: int | None = None) -> list[JobRecord]:
    """Those of as many jobs, one after another."""
    return [*LocalEngine(1, program(code)).outcomes([lambda one: one.run(TASK, keep_open=keep_open)] * count)]


DONE = "import dataclasses; return dataclasses.replace(task.record, state='done', message=str(os.getppid()))"


def test_a_process_takes_a_job_and_is_measured(held: int) -> None:
    (record,) = records(f'x = b"x" * (80 << 20); {DONE}', keep_open=held)
    assert (record.name, record.state) == ("a", "done")
    assert record.peak_mib > 80
    assert record.processor_s > 0


def test_jobs_are_copies_of_one_process_which_their_crashes_leave_alone(tmp_path: Path) -> None:
    first = tmp_path / "first"
    once = f"os.path.exists({str(first)!r}) or [open({str(first)!r}, 'x'), os.abort()]"
    crashed, *done = records(f"{once}; {DONE}", count=3)
    assert (crashed.state, crashed.exit_code, crashed.message) == ("failed", -6, "ended by signal 6")
    assert [one.state for one in done] == ["done", "done"]
    assert done[0].message == done[1].message


@pytest.mark.parametrize(
    ("code", "exit_code", "message"),
    [
        ("os._exit(143)", 143, "ended by signal 15"),
        ("os.kill(os.getppid(), 9)", -9, "ended by signal 9"),  # of the process that it is a copy of
        ("import nothing_like_it", 1, "ModuleNotFoundError: No module named 'nothing_like_it'"),
    ],
)
def test_a_process_that_gives_no_record_has_failed(code: str, exit_code: int, message: str) -> None:
    for record in records(code, count=2):
        assert (record.state, record.exit_code, record.message) == ("failed", exit_code, message)


def test_where_no_process_starts_there_is_a_line() -> None:
    (record,) = LocalEngine(1, ("-c", "import none")).outcomes([lambda one: one.run(TASK, keep_open=None)])
    assert (record.exit_code, record.message) == (1, "ModuleNotFoundError: No module named 'none'")


@pytest.fixture
def pipe(tmp_path: Path) -> Path:
    os.mkfifo(tmp_path / "pipe")
    return tmp_path / "pipe"


def sleeping(pipe: Path) -> tuple[str, str]:
    """Writes to this pipe, and holds it until it ends."""
    return program(f"import time; file = open({str(pipe)!r}, 'wb', 0); file.write(b'begun'); time.sleep(600)")


def test_leaving_ends_the_processes_at_work(held: int, pipe: Path) -> None:
    codes: list[int | None] = []

    def short(_: Engine) -> IO[bytes] | None:
        told = pipe.open("rb")
        assert told.read(5) == b"begun"
        return told

    def long(engine: Engine) -> None:
        codes.append(engine.run(TASK, keep_open=held).exit_code)

    with closing(LocalEngine(2, sleeping(pipe)).outcomes([long, short])) as outcomes:
        told = next(outcomes)
    assert codes == [143]
    assert told is not None
    with told:
        assert told.read() == b""


@pytest.mark.skipif(sys.platform != "linux", reason="prctl(2)")
def test_a_bound_process_ends_with_the_thread_that_started_it(pipe: Path) -> None:
    """Here the process that holds the thread is killed; a pipe tells when the job is gone."""
    code = f"""
import pickle
from lidcam.batches.local import LocalEngine
LocalEngine(1, {sleeping(pipe)!r}, is_bound=True).run(pickle.loads({pickle.dumps(TASK)!r}), keep_open=None)
"""
    with subprocess.Popen([sys.executable, "-c", code]) as starter, pipe.open("rb") as told:
        assert told.read(5) == b"begun"
        starter.kill()
        assert told.read() == b""
