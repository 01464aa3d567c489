"""Batches whose jobs do not take the time of a run; tests/e2e/test_batch.py has those that do."""

import fcntl
import os
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import pytest

from lidcam.batch.engine import Engine, Outcome
from lidcam.batch.jobs import BatchJob, find_jobs
from lidcam.batch.local import LocalEngine
from lidcam.batch.records import FOLDER, JobRecord, read_record, write_record
from lidcam.batch.run import BatchOptions, run_batch


class Written(LocalEngine):
    """Writes a result; fails where the recording says so."""

    def __init__(self) -> None:
        super().__init__(1)
        self.ran: list[str] = []

    def run(self, arguments: Sequence[str], *, keep_open: int | None) -> Outcome:
        recording, output = map(Path, arguments[:2])
        self.ran.append(recording.name)
        os.fstat(keep_open or 0)
        content = recording.read_bytes()
        if content.startswith(b"bad"):
            return Outcome(1, "lidcam: error: it is bad")
        output.write_bytes(content)
        return Outcome(3 if content.startswith(b"cut") else 0, "", b"", 1.0, 2.0, 3.0)


@pytest.fixture
def jobs(tmp_path: Path) -> list[BatchJob]:
    logs = tmp_path / "logs"
    logs.mkdir()
    for name, content in {"a": b"good", "b": b"bad, and long", "c": b"cut"}.items():
        (logs / f"{name}.bag").write_bytes(content)
    return find_jobs([str(logs)], tmp_path / "out")


@pytest.fixture
def options(tmp_path: Path) -> BatchOptions:
    return BatchOptions(tmp_path / "out", (), (), ("version",))


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
    assert done(jobs, replace(options, facts=("another version",)))[1] == ["b.bag", "a.bag", "c.bag"]
    assert done(jobs, replace(options, facts=("another version",), overwrite=True))[1] == ["b.bag", "a.bag", "c.bag"]


def test_after_a_failure_no_other_job_begins(jobs: list[BatchJob], options: BatchOptions) -> None:
    assert done(jobs, replace(options, fail_fast=True))[0] == ["failed"]


def test_what_was_at_work_when_a_batch_was_killed_is_done_again(
    jobs: list[BatchJob], options: BatchOptions, caplog: pytest.LogCaptureFixture
) -> None:
    done(jobs, options)
    place = folder(options) / FOLDER / "a.json"
    record = read_record(place)
    assert record is not None
    write_record(place, JobRecord(record.name, record.input, record.key, "begun"))
    assert done(jobs, options)[1] == ["b.bag", "a.bag"]
    assert "a: an earlier batch ended while it was at work on it" in caplog.text


@pytest.mark.parametrize("content", [b"", b"{}", b"[1]", b"{"])
def test_a_record_that_cannot_be_read_is_none(content: bytes, jobs: list[BatchJob], options: BatchOptions) -> None:
    done(jobs, options)
    (folder(options) / FOLDER / "a.json").write_bytes(content)
    assert done(jobs, options)[1] == ["b.bag", "a.bag"]


def test_a_job_at_which_another_batch_is_at_work_is_left_to_it(jobs: list[BatchJob], options: BatchOptions) -> None:
    (folder(options) / FOLDER).mkdir(parents=True)
    with (folder(options) / FOLDER / "a.lock").open("wb") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        assert done(jobs, options) == (["busy", "failed", "incomplete"], ["b.bag", "c.bag"])
        write_record(folder(options) / FOLDER / "a.json", JobRecord("a", "a.bag", "key", "begun"))
        assert done(jobs, options)[0] == ["busy", "failed", "incomplete"]


@pytest.fixture
def held(tmp_path: Path) -> Iterator[int]:
    with (tmp_path / "held").open("wb") as file:
        yield file.fileno()


def python(code: str, jobs: int = 1) -> LocalEngine:
    """Runs this for each job."""
    return LocalEngine(jobs, ("-c", code))


def test_a_process_is_measured_and_its_last_line_kept(held: int) -> None:
    code = """
import pathlib, sys
x = b"x" * (80 << 20)
pathlib.Path(sys.argv[-1]).write_text("{}")
print("first\\nlast", file=sys.stderr)
sys.exit(3)
"""
    outcome = python(code).run(["in", "out"], keep_open=held)
    assert (outcome.exit_code, outcome.message, outcome.figures) == (3, "last", b"{}")
    assert outcome.peak_mib > 80
    assert outcome.processor_s > 0
    assert python("import os; os.abort()").run((), keep_open=held).exit_code == -6


def test_leaving_ends_the_processes_at_work(held: int) -> None:
    codes: list[int] = []

    def short(_: Engine) -> str:
        return "short"

    def long(engine: Engine) -> str:
        codes.append(engine.run((), keep_open=held).exit_code)
        return "long"

    with closing(python("import time; time.sleep(600)", 2).outcomes([long, short])) as outcomes:
        assert next(outcomes) == "short"
    assert codes == [-15]


@pytest.mark.skipif(sys.platform != "linux", reason="prctl(2)")
def test_a_bound_process_ends_with_the_thread_that_started_it() -> None:
    """Here the process that holds the thread is killed; a pipe tells when the last that holds its end is gone."""
    end, held = os.pipe()
    sleeps = f"import os, time; os.write({held}, b'begun'); time.sleep(600)"
    code = f"""
from lidcam.batch.local import LocalEngine
LocalEngine(1, ("-c", {sleeps!r}), is_bound=True).run((), keep_open={held})
"""
    with subprocess.Popen([sys.executable, "-c", code], pass_fds=(held,)) as starter, os.fdopen(end, "rb") as told:
        os.close(held)
        assert told.read(5) == b"begun"
        starter.kill()
        assert told.read() == b""
