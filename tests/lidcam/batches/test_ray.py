"""Batches on a cluster of two nodes on this machine; a start of it takes seconds, so there is one."""

import os
import pickle
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pytest

from lidcam.batches.jobs import find_jobs
from lidcam.batches.local import LocalEngine, Task
from lidcam.batches.ray import RayEngine, _task
from lidcam.batches.records import JobRecord
from lidcam.batches.run import BatchOptions, run_batch
from lidcam.pipeline.core.errors import LidcamError, WorkerError
from lidcam.run.job import Job

ray = pytest.importorskip("ray", reason="Ray is not installed")
cluster_utils = pytest.importorskip("ray.cluster_utils")

PROGRAM = (
    "-c",
    """
import dataclasses, time
from lidcam.batches.worker import serve
def job(task):
    (recording,), (output,) = task.job.inputs, task.outputs
    sum(range(1_000_000))
    time.sleep(0.5)
    if recording.stem == "bad":
        return dataclasses.replace(task.record, state="failed", exit_code=1, message="it is bad")
    output.write_bytes(recording.read_bytes())
    with open(output.parent / "finished", "a") as file:
        file.write(recording.stem)
    return dataclasses.replace(task.record, state="done", exit_code=0)
serve(job)
""",
)
"""In place of the process of jobs, which take seconds; tests/e2e/test_batch.py takes that."""


TASK = Task(JobRecord("a", "a.bag", "key", "begun"), Job((Path("a.bag"),)), ())


@pytest.fixture(scope="module")
def cluster() -> Iterator[Any]:
    """A head that does no jobs, and two nodes with one core each."""
    cluster = cluster_utils.Cluster(initialize_head=True, head_node_args={"num_cpus": 0, "include_dashboard": False})
    for _ in range(2):
        cluster.add_node(num_cpus=1, wait=False)
    cluster.wait_for_nodes()
    yield cluster
    cluster.shutdown()


@pytest.mark.slow
def test_a_batch_goes_on_without_a_node_that_is_gone_and_makes_what_processes_make(
    cluster: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "logs").mkdir()
    for name in ("a", "b", "bad", "c", "d", "e"):
        (tmp_path / "logs" / f"{name}.bag").write_text(name)
    jobs = find_jobs([str(tmp_path / "logs")], tmp_path)
    out, options = tmp_path / "ray", BatchOptions(tmp_path / "ray", Job(()))
    told: list[str] = []

    def told_of(record: JobRecord) -> None:
        told.append(record.name)
        if len(told) == 1:
            cluster.remove_node(cluster.list_all_nodes()[-1], allow_graceful=False)

    records = run_batch(jobs, options, RayEngine(None, 1, cluster.address, PROGRAM), told_of)
    others = run_batch(jobs, replace(options, out=tmp_path / "local"), LocalEngine(3, PROGRAM), lambda _: None)
    assert capsys.readouterr().out == ""  # of Ray, which prints what happened to the node
    assert sorted(told) == ["a", "b", "bad", "c", "d", "e"]
    # A job that ended on the lost node before its record came is done again.
    assert {*(out / "finished").read_text()} == {"a", "b", "c", "d", "e"}
    assert [_facts(one) for one in records] == [_facts(one) for one in others]
    assert [one.state for one in records] == ["done", "done", "failed", "done", "done", "done"]
    assert all(one.processor_s > 0 and one.wall_s > 0.5 and one.peak_mib > 5 for one in records)


def _facts(record: JobRecord) -> tuple[object, ...]:
    return record.name, record.state, record.exit_code, record.message, record.outputs, record.key


@pytest.mark.slow
def test_a_cluster_without_room_is_told(cluster: Any) -> None:
    with pytest.raises(LidcamError, match="expected a node with 99 cores and 1500 MiB of memory, found none"):
        RayEngine(None, 99, cluster.address)


@pytest.mark.slow
def test_a_node_with_another_version_ends_the_batch(cluster: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    engine = RayEngine(1, 1, cluster.address)
    monkeypatch.setattr("lidcam.batches.ray.version", lambda _: "0.0.1")
    with pytest.raises(WorkerError, match=r"node .*: expected lidcam 0\.0\.1, found .*: install the same version"):
        [*engine.outcomes([lambda one: one.run(TASK, keep_open=None)])]


def test_a_node_without_lidcam_or_the_folder_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sent = ray.cloudpickle.dumps(_task())
    assert "expected the folder" in ray.cloudpickle.loads(sent)((), b"", str(tmp_path / "none"), version("lidcam"))
    for name in [name for name in sys.modules if name.partition(".")[0] == "lidcam"]:
        monkeypatch.setitem(sys.modules, name, None)
    monkeypatch.setattr(sys, "path", [])
    assert "found none" in ray.cloudpickle.loads(sent)((), b"", str(tmp_path), "0.1.0")


def test_without_ray_or_without_a_cluster_there_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(LidcamError, match=r"127\.0\.0\.1:9: expected the head of a Ray cluster, found none"):
        RayEngine(None, 1, "127.0.0.1:9")
    monkeypatch.setitem(sys.modules, "ray", None)
    monkeypatch.setattr("lidcam.batches.ray._closed", dict)  # the variables would stay
    with pytest.raises(LidcamError, match=r"not installed: pip install 'lidcam\[ray\]'"):
        RayEngine(None, 1, None)


CLOSED = """
import pickle, socket, sys
from lidcam.batches.ray import RayEngine
task = pickle.loads(bytes.fromhex(sys.argv[1]))
engine = RayEngine(1, 1, None, ("-c", "raise SystemExit('it ran')"))
import ray
(node,) = ray.nodes()
gcs = ray.get_runtime_context().gcs_address.rpartition(":")[2]
for port in (int(gcs), node["NodeManagerPort"], node["ObjectManagerPort"]):
    socket.create_connection(("127.0.0.1", port)).close()
    with socket.socket() as client:
        print(client.connect_ex(("127.0.0.2", port)) == 0)
print(*[one.message for one in engine.outcomes([lambda one: one.run(task, keep_open=None)])])
"""
"""Ports of Ray at 127.0.0.2 are open if it listens at all addresses of this machine."""


@pytest.mark.slow
def test_ray_on_this_machine_is_closed_and_leaves_nothing(tmp_path: Path) -> None:
    """Nor does it take code from the folder in which it is started."""
    (tmp_path / "lidcam.py").write_text("raise SystemExit('code of the folder')")
    with TemporaryDirectory() as home:  # its sockets need a short path
        settings = {key: value for key, value in os.environ.items() if not key.startswith("RAY_")}
        settings |= {"HOME": home, "TMPDIR": home, "PYTHONPATH": os.pathsep.join(sys.path)}
        command = [sys.executable, "-P", "-c", CLOSED, pickle.dumps(TASK).hex()]
        done = subprocess.run(command, cwd=tmp_path, env=settings, capture_output=True, text=True, check=True)
        assert done.stdout.splitlines() == [*["False"] * 3, "it ran"]
        assert list(Path(home).rglob("*")) == []
