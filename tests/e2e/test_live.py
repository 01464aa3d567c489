"""A run that is watched while it goes on."""

import socket
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from command import called
from foxglove.websocket import WebSocketServer
from foxglove_client import FoxgloveClient
from helpers import CLUSTERS, SANDBOX
from mcap.reader import make_reader

import lidcam
from lidcam.pipeline.core.frame import FrameResult
from lidcam.writers.live import server

USUAL: Any = {"config": "sandbox", "settings": [CLUSTERS], "workers": 1}


@pytest.fixture
def port() -> int:
    """One that is free."""
    with socket.socket() as unused:
        unused.bind(("127.0.0.1", 0))
        number: int = unused.getsockname()[1]
        return number


def test_foxglove_gets_what_the_file_gets(tmp_path: Path, port: int) -> None:
    """From the second frame on: it connects after the first. What comes once is sent again."""
    clients, log_times_ns = list[FoxgloveClient](), list[int]()

    def on_frame(frame: FrameResult) -> None:
        log_times_ns.append(frame.bundle.log_time_ns)
        if clients:  # one that is slow misses messages
            assert clients[0].wait_for(log_times_ns[-1])
        else:
            clients.append(FoxgloveClient(port))
            assert clients[0].subscribed.wait(60)

    lidcam.process(SANDBOX, tmp_path / "out.mcap", duration_s=0.6, foxglove=port, on_frame=on_frame, **USUAL)
    (client,) = clients
    client.join()
    expected: dict[str, list[tuple[int, bytes]]] = {}
    # Some of these are recorded later than the frame before, some sent after the first frame or as the server ends.
    copied = ("/ground_truth/",)
    with (tmp_path / "out.mcap").open("rb") as file:
        reader = make_reader(file)
        summary = reader.get_summary()
        assert summary is not None
        schemas = {channel.topic: summary.schemas[channel.schema_id] for channel in summary.channels.values()}
        for _, channel, message in reader.iter_messages(log_time_order=False):
            if message.log_time > log_times_ns[0] or channel.topic.startswith(("/tf_static", *copied)):
                expected.setdefault(channel.topic, []).append((message.log_time, message.data))
    told = {topic: (one["schemaName"], one["schema"]) for topic, one in client.channels.items()}
    assert told == {topic: (schema.name, schema.data.decode()) for topic, schema in schemas.items()}
    assert len(log_times_ns) > 2
    for topic, found in client.messages.items():
        begin = expected[topic].index(found[0])
        assert found == expected[topic][begin : begin + len(found)], topic
    late = {topic for topic, found in client.messages.items() if len(found) < len(expected[topic])}
    assert all(topic.startswith(copied) for topic in late | (expected.keys() - client.messages.keys()))
    assert len(client.messages["/point_cloud_combined"][-1][1]) > 10_000
    assert client.times_ns[-1] == log_times_ns[-1]
    assert (client.server["name"], client.server["capabilities"]) == ("sandbox.bag", ["time"])


def test_who_says_nothing_does_not_hold_up_the_end(tmp_path: Path, port: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """The outputs have their names before the server stops."""
    out, clients, was_named = tmp_path / "out.mcap", list[socket.socket](), list[bool]()
    stop = server._stop

    def stopped(one: WebSocketServer) -> None:
        was_named.append(out.exists())
        stop(one)

    def connect(_: FrameResult) -> None:
        if not clients:
            clients.extend(socket.create_connection(("127.0.0.1", port)) for _ in range(2))
            clients[1].sendall(b"GET / HTTP/1.1\r\n")

    monkeypatch.setattr(server, "_stop", stopped)
    lidcam.process(SANDBOX, out, settings=[CLUSTERS], duration_s=0.3, workers=1, foxglove=port, on_frame=connect)
    assert was_named == [True]
    for client in clients:
        with client:
            assert client.recv(1) == b""


def test_a_port_that_is_taken(tmp_path: Path) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        given = ("--foxglove", taken.getsockname()[1], "--duration", "0.2", "--workers", "1")
        done = called(tmp_path, "process", SANDBOX, "out.mcap", *given)
    assert done.code == 1
    assert "foxglove: expected a free port, found 127.0.0.1:" in done.error_line
    assert list(tmp_path.iterdir()) == []


def test_a_run_keeps_the_pace_of_its_recording(monkeypatch: pytest.MonkeyPatch) -> None:
    """Seen by a clock that only the waiting moves."""
    now_s, seen = 100.0, list[tuple[float, float]]()

    def sleep(seconds: float) -> None:
        nonlocal now_s
        now_s += seconds

    monkeypatch.setattr("lidcam.outputs.writers.time", SimpleNamespace(monotonic=lambda: now_s, sleep=sleep))

    def see(frame: FrameResult) -> None:
        seen.append((now_s, frame.bundle.stamp_ns / 1e9))

    lidcam.process(SANDBOX, duration_s=0.5, pace=0.5, on_frame=see, **USUAL)
    (first_s, first_stamp_s), *later = seen
    assert first_s == 100.0
    assert len(later) > 2
    waited_s, recorded_s = zip(*((at_s - first_s, stamp_s - first_stamp_s) for at_s, stamp_s in later), strict=True)
    assert waited_s == pytest.approx([2 * seconds for seconds in recorded_s])
