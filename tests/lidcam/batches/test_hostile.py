"""Names, records and results of a batch that somebody has chosen or changed."""

import os
import shutil
from collections.abc import Callable
from dataclasses import replace
from itertools import chain
from pathlib import Path

import pytest
from written_jobs import Written

from lidcam.batches.jobs import RECORDS, BatchJob, find_jobs
from lidcam.batches.records import JobRecord, record_of, record_text
from lidcam.batches.run import BatchOptions, run_batch
from lidcam.batches.store import Store, records_table
from lidcam.outputs.written import WrittenFile
from lidcam.readers.location import RemotePath
from lidcam.run.job import Job

NAMES = {
    "an empty one, '.' or '..'": ("/home/u/package", "//", "a//b", "../../up", "a/../b", "a/..", "./here", "."),
    "a backslash": ("..\\up", "C:\\up", "a\nb", "a\0b", "\x1b[2J\x1b]0;title\x07", "a\x9bb", "day\n/drive", "\udce9"),
    "what lidcam itself writes": (
        f"{RECORDS}/x",
        f"{RECORDS}/day/drive.json",
        RECORDS,
        "_jobs",
        ".a.json.lidcam-x/a.json",
    ),
    "one of more than 200 bytes": ("a" * 201, "é" * 101, f"day/{'a' * 900}", f"{'a' * 300}/drive"),
}
"""Names of recordings below the folder that is given, which no result has, by the reason."""

SOUND = ("day/drive", "-x", "~", ".hidden", "2024-01-01T10:00:00", "día 1/$HOME;`ls`", "a..b")


class Found:
    """The bucket of these recordings."""

    def __init__(self, root: RemotePath) -> None:
        self._root = root.url

    def found(self) -> list[tuple[RemotePath, int]]:
        return [(RemotePath(f"{self._root}/{name}.mcap"), 1) for name in (*chain(*NAMES.values()), *SOUND)]


def batch(jobs: list[BatchJob], out: Path) -> tuple[list[JobRecord], list[str]]:
    """Its records, and the recordings that were processed for them."""
    engine = Written()
    return run_batch(jobs, BatchOptions(out, Job(())), engine, lambda _: None), engine.ran


def test_keys_choose_no_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lidcam.batches.jobs.Bucket", Found)
    jobs = find_jobs(["s3://fleet/logs"], tmp_path / "out")
    assert {job.name for job in jobs if not job.fault} == {*SOUND}
    records, ran = batch([job for job in jobs if job.fault], tmp_path / "out")
    messages = {record.input: record.message for record in records}
    for fault, names in NAMES.items():
        for name in names:
            key = name.encode(errors="backslashreplace").decode()
            assert f"found {fault}" in messages.pop(f"s3://fleet/logs/{key}.mcap")
    assert (messages, ran) == ({}, [])
    assert all((one.state, one.exit_code, one.name.isprintable()) == ("failed", 1, True) for one in records)
    assert [path.name for path in tmp_path.rglob("*") if not path.is_dir()] == [".lock"]
    assert records_table(records)


def test_a_recording_in_the_way_of_another_fails_alone(tmp_path: Path) -> None:
    (tmp_path / "logs" / "a.mcap").mkdir(parents=True)
    for name in ("a.bag", "a.mcap/b.bag", "c.bag"):
        (tmp_path / "logs" / name).write_bytes(b"content")
    (tmp_path / "out" / "a.mcap").mkdir(parents=True)
    (tmp_path / "out" / "c").touch()
    records, _ = batch(find_jobs([str(tmp_path / "logs")], tmp_path / "out"), tmp_path / "out")
    assert {record.name: record.state for record in records} == {"a": "failed", "a.mcap/b": "done", "c": "done"}


RECORD = JobRecord(
    "a", "a.bag", "key", "done", 0, outputs={"a.mcap": WrittenFile(4, "abc", "1 2 3")}, objects={"car": 2}, sha256=["d"]
)


def test_no_damage_of_a_record_goes_unseen() -> None:
    text = record_text(RECORD)
    for place in range(len(text)):
        assert record_of(text[:place]) is None
        assert record_of(text[:place] + bytes([text[place] ^ 1]) + text[place + 1 :]) is None
    for other in (b"", b"[" * 100_000, b"null", b"\xff" * 100, text + b"x"):
        assert record_of(other) is None


def flip(path: Path) -> None:
    """Of the same size and time of its last write."""
    before, content = path.stat(), bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)
    os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))


def link(path: Path) -> None:
    path.rename(path.with_name("elsewhere"))
    path.symlink_to("elsewhere")


def record(changes: Callable[[JobRecord], JobRecord]) -> Callable[[Path], None]:
    def change(path: Path) -> None:
        store = Store(path.parent)
        known = store.record("a")
        assert known is not None
        store.files.put(f"{RECORDS}/a.json", record_text(changes(known)))

    return change


DAMAGE: dict[str, Callable[[Path], object]] = {
    "nine bytes": lambda path: path.write_bytes(b"nine byte"),
    "flipped": flip,
    "a link": link,
    "none": record(lambda known: replace(known, outputs=None)),
    "other outputs": record(lambda known: replace(known, outputs={"b.mcap": (known.outputs or {})["a.mcap"]})),
    "another name": record(lambda known: replace(known, name="../../b")),
    "a huge record": lambda path: os.truncate(path.parent / RECORDS / "a.json", 1 << 40),
}


@pytest.fixture
def jobs(tmp_path: Path) -> list[BatchJob]:
    (tmp_path / "a.bag").write_bytes(b"content of a recording")
    return find_jobs([str(tmp_path / "a.bag")], tmp_path / "out")


@pytest.mark.parametrize("damage", DAMAGE)
def test_a_result_is_done_if_its_checksum_says_so(
    tmp_path: Path, jobs: list[BatchJob], damage: str, caplog: pytest.LogCaptureFixture
) -> None:
    batch(jobs, tmp_path / "out")
    assert batch(jobs, tmp_path / "out")[1] == []
    DAMAGE[damage](tmp_path / "out" / "a.mcap")
    ((known,), ran) = batch(jobs, tmp_path / "out")
    if damage == "a link":
        assert (known.state, "found a link" in known.message, ran) == ("failed", True, [])
    else:
        assert (known.state, known.name, ran) == ("done", "a", ["a.bag"])
        assert "it is processed again" in caplog.text


def test_a_copy_of_the_results_is_still_done(tmp_path: Path, jobs: list[BatchJob]) -> None:
    """Other inodes and times: the checksums decide."""
    batch(jobs, tmp_path / "out")
    shutil.copytree(tmp_path / "out", tmp_path / "copy")
    assert batch(jobs, tmp_path / "copy")[1] == []
