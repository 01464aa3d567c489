"""Recordings from an object store, and results to one: moto's server on this machine plays it."""

import io
import json
from collections.abc import Iterator
from pathlib import Path

import fsspec
import pyarrow.parquet as pq
import pytest
from builders import write_mcap
from command import Lidcam
from helpers import CLUSTERS
from long_recording import write_long_recording
from object_store import ObjectStore, object_store
from small_drive import small_drive

from lidcam.batches.jobs import find_jobs
from lidcam.batches.local import LocalEngine
from lidcam.batches.records import job_key
from lidcam.batches.run import BatchOptions, run_batch
from lidcam.readers.location import RemotePath
from lidcam.run.job import Job

pytestmark = pytest.mark.slow

SHORT = ("--duration", "0.4", "--set", "output.images=false", "--set", CLUSTERS, "--workers", 1, "-q")


@pytest.fixture(scope="module")
def running() -> Iterator[ObjectStore]:
    with object_store() as store, pytest.MonkeyPatch.context() as patch:
        for name, value in {
            "AWS_ACCESS_KEY_ID": "ada",
            "AWS_SECRET_ACCESS_KEY": "s3cret",
            "AWS_DEFAULT_REGION": "us-east-1",
            "AWS_ENDPOINT_URL_S3": store.url,
            "AWS_MAX_ATTEMPTS": "2",
        }.items():
            patch.setenv(name, value)
        yield store


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("drive") / "drive.mcap"
    write_mcap(path, small_drive("cdr"))
    return path


class Fleet:
    """What is in the bucket."""

    def __init__(self) -> None:
        self.system = fsspec.filesystem("s3", skip_instance_cache=True, use_listings_cache=False)

    def __setitem__(self, name: str, content: bytes) -> None:
        self.system.pipe(f"fleet/{name}", content)

    def __getitem__(self, name: str) -> bytes:
        return bytes(self.system.cat(f"fleet/{name}"))

    def names(self) -> list[str]:
        return sorted(name.removeprefix("fleet/") for name in self.system.find("fleet"))


@pytest.fixture
def store(running: ObjectStore) -> ObjectStore:
    running.left = 0
    running.sent.clear()
    return running


@pytest.fixture
def fleet(store: ObjectStore) -> Fleet:  # noqa: ARG001  # by the environment
    fleet = Fleet()
    if fleet.system.exists("fleet"):
        fleet.system.rm("fleet", recursive=True)
    fleet.system.mkdir("fleet")
    return fleet


def test_process_from_and_to_a_bucket(lidcam: Lidcam, fleet: Fleet, drive: Path, tmp_path: Path) -> None:
    fleet["drive.mcap"] = drive.read_bytes()
    more = ("--objects", "s3://fleet/new/out.parquet", "--rerun", tmp_path / "out.rrd")
    arguments = ("process", "s3://fleet/drive.mcap", "s3://fleet/new/out.mcap", *SHORT, *more)
    run = lidcam(*arguments, "--json")
    assert run.code == 0, run.err
    assert json.loads(run.out)["outputs"] == [
        str(tmp_path / "out.rrd"),
        *(f"s3://fleet/new/out.{ending}" for ending in ("mcap", "parquet", "foxglove.json")),
    ]
    assert lidcam("process", "s3://fleet/drive.mcap", tmp_path / "out.mcap", *SHORT).code == 0
    assert fleet["new/out.mcap"] == (tmp_path / "out.mcap").read_bytes()
    assert pq.read_table(io.BytesIO(fleet["new/out.parquet"])).num_columns > 10
    assert fleet.names() == ["drive.mcap", "new/out.foxglove.json", "new/out.mcap", "new/out.parquet"]
    assert (tmp_path / "out.rrd").is_file()
    assert lidcam(*arguments).code == 0  # a result of an earlier run


def test_one_second_of_a_recording_is_read_in_parts(
    lidcam: Lidcam, fleet: Fleet, store: ObjectStore, tmp_path: Path
) -> None:
    write_long_recording(tmp_path / "rec.mcap")
    content = (tmp_path / "rec.mcap").read_bytes()
    fleet["rec.mcap"] = content
    store.sent.clear()
    run = lidcam("process", "s3://fleet/rec.mcap", tmp_path / "out.mcap", "--start", 30, *SHORT)
    assert run.code == 0, run.err
    assert store.sent["/fleet/rec.mcap"] < 0.2 * len(content)


@pytest.mark.parametrize(
    ("output", "told"),
    [
        ("s3://nothing/out.mcap", "there is no such bucket; check the address"),
        ("s3://fleet/other.mcap", "exists and was not written by lidcam"),
        ("s3://fleet/drive.mcap", "is an input of this run"),
        ("https://ada:s3cret@host/out.mcap", "expected a local path, or s3://bucket/..., as output"),
    ],
)
def test_an_output_that_cannot_be(lidcam: Lidcam, fleet: Fleet, drive: Path, output: str, told: str) -> None:
    fleet["drive.mcap"] = fleet["other.mcap"] = drive.read_bytes()
    run = lidcam("process", "s3://fleet/drive.mcap", output, *SHORT)
    assert run.code == 1
    assert told in run.error_line
    assert "s3cret" not in run.err
    assert fleet.names() == ["drive.mcap", "other.mcap"]


@pytest.mark.parametrize(
    ("status", "told"),
    [
        (403, "access was denied (HTTP 403); check the credentials"),
        (503, "HTTP 503 after several attempts; check the network, and try again"),
    ],
)
def test_a_store_that_does_not_take_a_result(
    lidcam: Lidcam, fleet: Fleet, store: ObjectStore, drive: Path, status: int, told: str
) -> None:
    store.fail("PUT /fleet/out.mcap", times=10**6, status=status)
    run = lidcam("process", drive, "s3://fleet/out.mcap", *SHORT)
    assert run.code == 1
    assert run.error_line.startswith("lidcam: error: s3://fleet/out.mcap: ")
    assert told in run.error_line
    assert "s3cret" not in run.err
    assert fleet.names() == ["out.foxglove.json"]  # the result goes last


def test_what_passes_is_tried_again(lidcam: Lidcam, fleet: Fleet, store: ObjectStore, drive: Path) -> None:
    store.fail("PUT /fleet/out.mcap", times=1)
    run = lidcam("process", drive, "s3://fleet/out.mcap", *SHORT)
    assert run.code == 0, run.err
    assert fleet.names() == ["out.foxglove.json", "out.mcap"]


def test_a_batch_from_and_to_a_bucket(lidcam: Lidcam, fleet: Fleet, store: ObjectStore, drive: Path) -> None:
    fleet["logs/day/drive.mcap"] = drive.read_bytes()
    fleet["logs/results/old.mcap"] = b"a result"
    batch = ("batch", "s3://fleet/logs", "--out", "s3://fleet/logs/results", *SHORT, "--objects", "--json")
    run = lidcam(*batch)
    assert run.code == 0, run.err
    (job,) = json.loads(run.out)["jobs"]
    assert (job["name"], job["state"], job["frames"]) == ("day/drive", "done", 4)
    made = [name.removeprefix("logs/results/") for name in fleet.names() if name.startswith("logs/results/")]
    results = [f"day/drive.{ending}" for ending in ("foxglove.json", "mcap", "parquet")]
    assert made == [".lidcam-batch/day/drive.json", "_jobs.parquet", *results, "index.html", "old.mcap"]
    table = pq.read_table(io.BytesIO(fleet["logs/results/_jobs.parquet"]))
    assert table.column("state").to_pylist() == ["done"]
    store.fail("PUT /fleet/logs/results/day", times=1)
    assert lidcam(*batch).code == 0
    assert store.left == 1  # it was not made again


def test_recordings_of_a_bucket(fleet: Fleet, drive: Path) -> None:
    messages = small_drive("cdr", frames=9)
    for number, part in enumerate((messages[: len(messages) // 2], messages[len(messages) // 2 :])):
        path = drive.with_name(f"c_{number}.mcap")
        write_mcap(path, part)
        fleet[f"logs/day/{path.name}"] = path.read_bytes()
    fleet["logs/text.bag"] = b"no recording"
    fleet["logs/notes.txt"] = b""
    whole, text = find_jobs(["s3://fleet/logs"], Path("out"))
    assert (whole.name, len(whole.inputs), text.name, text.bytes) == ("day/c", 2, "text", 12)
    (named,) = find_jobs(["s3://fleet/logs/text.bag"], Path("out"))
    assert named.inputs == text.inputs
    before = job_key(whole, ())
    assert job_key(whole, ()) == before
    fleet["logs/day/c_1.mcap"] = b"another"
    assert job_key(whole, ()) != before


def test_a_record_that_is_not_taken_fails_its_job_alone(fleet: Fleet, store: ObjectStore, drive: Path) -> None:
    for name in ("a", "b"):
        fleet[f"logs/{name}.bag"] = b"no recording"
    store.fail("PUT /fleet/results/.lidcam-batch/a")
    options = BatchOptions(RemotePath("s3://fleet/results"), Job(()))
    one, other = run_batch(find_jobs(["s3://fleet/logs"], drive), options, LocalEngine(1), lambda _: None)
    assert (one.state, other.state) == ("failed", "failed")
    assert one.message.startswith("s3://fleet/results/.lidcam-batch/a.json: HTTP 503 after several attempts")
    assert "s3://fleet/logs/b.bag: of files on a server, lidcam reads .mcap" in other.message


@pytest.mark.usefixtures("fleet")
@pytest.mark.parametrize(
    ("given", "told"),
    [
        ("s3://fleet/none", "expected recordings"),
        ("s3://nothing/logs", "s3://nothing/logs: there is no such bucket; check the address"),
    ],
)
def test_a_bucket_without_recordings(lidcam: Lidcam, tmp_path: Path, given: str, told: str) -> None:
    assert told in lidcam("batch", given, "--out", tmp_path / "out").error_line
