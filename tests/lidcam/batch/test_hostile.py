"""Names, records and results of a batch that somebody has chosen or changed."""

import json
import os
import shutil
import subprocess
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path

import pytest
from written_jobs import Written

from lidcam.batch.jobs import RECORDS, BatchJob, find_jobs
from lidcam.batch.records import JobRecord, job_key, record_of, record_text
from lidcam.batch.run import BatchOptions, run_batch
from lidcam.batch.store import Store
from lidcam.batch.table import records_table
from lidcam.outputs.written import WrittenFile
from lidcam.pipeline.core.errors import RecordingError
from lidcam.readers.location import RemotePath
from lidcam.run.job import Job
from lidcam.writers.outputs.marks import marked_json

DOTS, LETTERS, OWN, LONG = (
    "found an empty one",
    "found a backslash",
    "found what the batch itself",
    "more than 200 bytes",
)

KEYS = {
    "/home/u/package.mcap": DOTS,
    "//etc/cron.mcap": DOTS,
    "///.mcap": DOTS,
    "/.mcap": DOTS,
    "a//b.mcap": DOTS,
    "a/b//c/d.mcap": DOTS,
    "../up.mcap": DOTS,
    "../../../home/u/package.mcap": DOTS,
    "a/../../up.mcap": DOTS,
    "a/../b.mcap": DOTS,
    "a/..//b.mcap": DOTS,
    "./here.mcap": DOTS,
    "a/./b.mcap": DOTS,
    "..mcap": DOTS,
    "...mcap": DOTS,
    "a/..mcap": DOTS,
    "a/...bag": DOTS,
    "a\\b.mcap": LETTERS,
    "..\\..\\up.mcap": LETTERS,
    "C:\\up.mcap": LETTERS,
    "C:up.mcap": "found a drive",
    "c:/windows/up.mcap": "found a drive",
    "a\nb.mcap": LETTERS,
    "a\rb.mcap": LETTERS,
    "a\tb.mcap": LETTERS,
    "a\0b.mcap": LETTERS,
    "\x1b[2J\x1b]0;title\x07.mcap": LETTERS,
    "a\x7fb.mcap": LETTERS,
    "a\x9bb.mcap": LETTERS,
    "day\n/drive.mcap": LETTERS,
    "latin\udce9.mcap": LETTERS,
    f"{RECORDS}/x.mcap": OWN,
    f"{RECORDS}/day/drive.json.mcap": OWN,
    f"{RECORDS}.mcap": OWN,
    "_jobs.mcap": OWN,
    "_jobs.bag.zst": OWN,
    f"{'a' * 201}.mcap": LONG,
    f"{'é' * 101}.mcap": LONG,
    f"day/{'a' * 900}.mcap": LONG,
    f"{'a' * 300}/drive.mcap": LONG,
}
"""What a bucket may hold below the folder that is given, and why no result has its name."""

SOUND = (
    "day/drive.mcap",
    "-x.mcap",
    "~.mcap",
    ".hidden.mcap",
    "2024-01-01T10:00:00.mcap",
    "día 1/$HOME;`ls`.mcap",
    "a..b.mcap",
)


class Found:
    """The bucket of these keys."""

    def __init__(self, root: RemotePath) -> None:
        self._root = root.url

    def found(self) -> list[tuple[RemotePath, int]]:
        return [(RemotePath(f"{self._root}/{key}"), 1) for key in (*KEYS, *SOUND)]


def batch(jobs: list[BatchJob], out: Path) -> tuple[list[JobRecord], list[str]]:
    """Its records, and the recordings that were processed for them."""
    engine = Written()
    return run_batch(jobs, BatchOptions(out, Job(())), engine, lambda _: None), engine.ran


def files_in(folder: Path) -> set[str]:
    return {str(path.relative_to(folder)) for path in folder.rglob("*") if not path.is_dir()}


def test_40_keys_choose_no_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lidcam.batch.jobs.Bucket", Found)
    jobs = find_jobs(["s3://fleet/logs"], tmp_path / "out")
    assert {job.name for job in jobs if not job.fault} == {key.removesuffix(".mcap") for key in SOUND}
    refused = [job for job in jobs if job.fault]
    assert len(refused) == len(KEYS) == 40
    records, ran = batch(refused, tmp_path / "out")
    faults = {record.input.removeprefix("s3://fleet/logs/"): record for record in records}
    for key, fault in KEYS.items():
        record = faults[key.encode(errors="backslashreplace").decode()]
        assert (record.state, record.exit_code) == ("failed", 1)
        assert fault in record.message
        assert record.name.isprintable()
    assert ran == []
    assert files_in(tmp_path) == {f"out/{RECORDS}/.lock"}
    assert records_table(records)


def test_names_of_local_files(tmp_path: Path) -> None:
    names = [
        key for key in KEYS if "/" not in key and "\0" not in key and len(os.fsencode(key)) < 256 and key[0] != "."
    ]
    (tmp_path / "logs").mkdir()
    for name in (*names, "good.bag"):
        (tmp_path / "logs" / name).write_bytes(b"content")
    records, ran = batch(find_jobs([str(tmp_path / "logs")], tmp_path / "out"), tmp_path / "out")
    assert len(names) >= 14
    assert sorted(record.state for record in records) == ["done", *["failed"] * len(names)]
    assert ran == ["good.bag"]
    assert files_in(tmp_path / "out") == {
        "good.mcap",
        *(f"{RECORDS}/{one}" for one in (".lock", "good.json", "good.lock")),
    }


def test_a_bag_folder_that_one_is_in(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "bag" / "sub").mkdir(parents=True)
    (tmp_path / "bag" / "metadata.yaml").touch()
    for here, given in (("bag", "."), ("bag/sub", "..")):
        monkeypatch.chdir(tmp_path / here)
        assert [job.name for job in find_jobs([given], tmp_path / "out")] == ["bag"]


def test_a_recording_in_the_way_of_another_fails_alone(tmp_path: Path) -> None:
    (tmp_path / "logs" / "a.mcap").mkdir(parents=True)
    for name in ("a.bag", "a.mcap/b.bag", "c.bag"):
        (tmp_path / "logs" / name).write_bytes(b"content")
    (tmp_path / "out" / "a.mcap").mkdir(parents=True)
    (tmp_path / "out" / "c").touch()
    records, _ = batch(find_jobs([str(tmp_path / "logs")], tmp_path / "out"), tmp_path / "out")
    assert {record.name: record.state for record in records} == {"a": "failed", "a.mcap/b": "done", "c": "done"}


def test_a_tree_of_1100_folders(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """First in the folder of a ROS 2 bag, where none is looked for."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "logs" / "bag").mkdir(parents=True)
    (tmp_path / "logs" / "a.bag").write_bytes(b"content")
    (tmp_path / "logs" / "bag" / "metadata.yaml").write_bytes(b"content")
    folder = os.open("logs/bag", os.O_RDONLY)
    for _ in range(1100):
        os.mkdir("d", dir_fd=folder)
        below = os.open("d", os.O_RDONLY, dir_fd=folder)
        os.close(folder)
        folder = below
    os.close(folder)
    try:
        jobs = find_jobs(["logs"], tmp_path / "out")
        assert [(job.name, job_key(job, ()) != "") for job in jobs] == [("a", True), ("bag", True)]
        Path("logs/bag/d").rename("logs/d")
        assert find_jobs(["logs"], tmp_path / "out") == jobs
        with pytest.raises(RecordingError, match=r"found nothing of this pattern|too deep for a pattern"):
            find_jobs(["logs/**/*.none"], tmp_path / "out")
    finally:
        subprocess.run(["rm", "-r", "logs"], check=True)  # shutil cannot


@pytest.mark.parametrize("name", ["fifo", "@fifo", "@/dev/zero"])
def test_nothing_is_waited_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    monkeypatch.chdir(tmp_path)
    os.mkfifo("fifo")
    with pytest.raises(RecordingError, match="expected a"):
        find_jobs([name], tmp_path / "out")


RECORD = JobRecord(
    "a", "a.bag", "key", "done", 0, outputs={"a.mcap": WrittenFile(4, "abc", "1 2 3")}, objects={"car": 2}, sha256=["d"]
)
ALTERED: list[dict[str, object]] = [
    {"outputs": [1]},
    {"outputs": "abc"},
    {"outputs": {"a.mcap": 4}},
    {"outputs": {"a.mcap": {"bytes": -4, "checksum": 5}}},
    {"objects": [1, 2]},
    {"objects": {"car": "two"}},
    {"objects": {"car": -1}},
    {"frames": "many"},
    {"frames": 10**30},
    {"frames": 1.5},
    {"exit_code": "0"},
    {"exit_code": 10**9},
    {"message": 5},
    {"sha256": 3},
    {"name": 5},
    {"name": None},
    {"state": "weird"},
    {"lacking": "abc"},
    {"skew_max_ms": "x"},
    {"skew_max_ms": float("inf")},
    {"wall_s": float("nan")},
    {"peak_mib": None},
    {"key": 3},
]


@pytest.mark.parametrize("changes", ALTERED, ids=str)
def test_a_record_that_somebody_has_made_counts_as_none(changes: dict[str, object]) -> None:
    """Its checksum is right."""
    assert record_of(record_text(RECORD)) == RECORD
    assert record_of(marked_json(json.dumps(asdict(RECORD) | changes, indent=1) + "\n").encode()) is None


def test_no_damage_of_a_record_goes_unseen() -> None:
    text = record_text(RECORD)
    for place in range(len(text)):
        assert record_of(text[:place]) is None
        assert record_of(text[:place] + bytes([text[place] ^ 1]) + text[place + 1 :]) is None
    for other in (b"", b"[" * 100_000, b"null", b"\xff" * 100, text + b"x"):
        assert record_of(other) is None


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-1])


def flip(path: Path) -> None:
    """Of the same size and time of its last write."""
    before, content = path.stat(), bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)
    os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))


def link(path: Path) -> None:
    path.rename(path.with_name("elsewhere"))
    path.symlink_to("elsewhere")


def fifo(path: Path) -> None:
    path.unlink()
    os.mkfifo(path)


def record(changes: Callable[[JobRecord], JobRecord]) -> Callable[[Path], None]:
    def change(path: Path) -> None:
        store = Store(path.parent)
        known = store.record("a")
        assert known is not None
        store.files.put(f"{RECORDS}/a.json", record_text(changes(known)))

    return change


DAMAGE: dict[str, Callable[[Path], object]] = {
    "missing": Path.unlink,
    "empty": lambda path: path.write_bytes(b""),
    "nine bytes": lambda path: path.write_bytes(b"nine byte"),
    "cut": cut,
    "longer": lambda path: path.write_bytes(path.read_bytes() + b"\0"),
    "flipped": flip,
    "a link": link,
    "a fifo": fifo,
    "no outputs": record(lambda known: replace(known, outputs={})),
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
    assert (known.state, known.name, ran) == ("failed" if damage in {"a link", "a fifo"} else "done", "a", ["a.bag"])
    assert "a: " in caplog.text
    assert "it is processed again" in caplog.text


def test_a_copy_of_the_results_is_still_done(tmp_path: Path, jobs: list[BatchJob]) -> None:
    """Other inodes and times: the checksums decide."""
    batch(jobs, tmp_path / "out")
    shutil.copytree(tmp_path / "out", tmp_path / "copy")
    assert batch(jobs, tmp_path / "copy")[1] == []
