"""A recording on a server gives what the same file on disk gives."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from command import Lidcam
from helpers import CLUSTERS
from long_recording import LENGTH_S, MESSAGES, START_NS, write_long_recording
from mcap.reader import make_reader
from range_server import RangeServer, range_server

WINDOW = ("--start", 30, "--duration", 3, "--set", CLUSTERS)


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("remote") / "rec.mcap"
    write_long_recording(path)
    return path


@pytest.fixture
def server(recording: Path) -> Iterator[RangeServer]:
    with range_server({"/drives/rec.mcap": recording.read_bytes()}) as state:
        yield state


@pytest.fixture
def url(server: RangeServer) -> str:
    return server.url.replace("://", "://ada:s3cret@") + "/drives/rec.mcap?X-Amz-Signature=s3cret"


def content_of(path: Path) -> tuple[list[Any], dict[str, str]]:
    """Messages and attachments, and what is said of the run."""
    with path.open("rb") as file:
        reader = make_reader(file)
        messages: list[Any] = [(channel.topic, m) for _, channel, m in reader.iter_messages(log_time_order=False)]
        attachments = [(one.name, one.log_time, one.data) for one in reader.iter_attachments()]
        (metadata,) = [record.metadata for record in reader.iter_metadata() if record.name == "lidcam"]
    return messages + attachments, metadata


@pytest.mark.slow
def test_window_of_a_recording_on_a_server(
    lidcam: Lidcam, recording: Path, server: RangeServer, url: str, tmp_path: Path
) -> None:
    local, remote = tmp_path / "local.mcap", tmp_path / "remote.mcap"
    assert lidcam("process", recording, local, *WINDOW).code == 0
    done = lidcam("process", url, remote, *WINDOW, "--rerun", tmp_path / "remote.rrd")
    assert done.code == 0, done.err
    viewed = (tmp_path / "remote.rrd").read_bytes()
    assert b"rec.mcap" in viewed  # the name of the recording in the viewer
    assert b"s3cret" not in viewed
    assert "Warning" not in done.err
    expected, got = content_of(local), content_of(remote)
    assert len(expected[0]) > 100
    assert got[0] == expected[0]
    said, known = ({key: run[key] for key in run if not key.startswith("input.")} for run in (got[1], expected[1]))
    assert said == known
    source = {key.removeprefix("input.0."): value for key, value in got[1].items() if key.startswith("input.")}
    assert (source["name"], source["url"]) == ("rec.mcap", f"{server.url}/drives/rec.mcap?...")
    assert source["size"] == str(recording.stat().st_size)
    assert {"etag", "last_modified"} <= source.keys()
    assert server.sent < 0.25 * recording.stat().st_size
    assert len(server.requests) < 25
    assert b"s3cret" not in remote.read_bytes()
    assert "s3cret" not in done.out + done.err


def test_inspect_looks_at_the_beginning(lidcam: Lidcam, recording: Path, server: RangeServer, url: str) -> None:
    done = lidcam("inspect", url, "--json")
    assert done.code == 0, done.err
    found = json.loads(done.out)
    assert found["files"] == [f"{server.url}/drives/rec.mcap?..."]
    assert found["messages"] == MESSAGES
    assert found["looked_at_until_ns"] == START_NS + 5 * 10**9
    topics = {topic["topic"]: topic for topic in found["topics"]}
    assert topics["/points"]["count"] == 10 * LENGTH_S
    assert topics["/points"]["rate_hz"] == pytest.approx(10)
    assert found["motion"] == ["/tf"]
    assert server.sent < 0.2 * recording.stat().st_size
    done = lidcam("inspect", url)
    assert "only the first 5 s were examined, except for the counts: the files are on a server" in done.out
    assert "s3cret" not in done.out + done.err


def test_repair_reads_all_of_it(lidcam: Lidcam, server: RangeServer, url: str, tmp_path: Path) -> None:
    content = server.files["/drives/rec.mcap"]
    server.files["/drives/rec.mcap"] = content[: len(content) // 4]
    done = lidcam("inspect", url, "--repair", tmp_path / "whole.mcap")
    assert done.code == 3, done.err
    assert "no more is looked at" not in done.out
    assert "all of it is fetched, 6.9 MB" in done.err
    with (tmp_path / "whole.mcap").open("rb") as file:
        summary = make_reader(file).get_summary()
        (record,) = [record.metadata for record in make_reader(file).iter_metadata() if "file" in record.metadata]
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_count > 0.2 * MESSAGES
    assert record["file"] == "rec.mcap"
    assert "s3cret" not in done.out + done.err
