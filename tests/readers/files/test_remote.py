"""Recordings on a server: only what is needed is fetched, what goes wrong is said in one line without secrets."""

import base64
import gc
import io
import sys
from collections.abc import Iterator
from pathlib import Path
from random import Random
from typing import Any
from unittest.mock import patch

import fsspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from long_recording import LENGTH_S, SECOND_NS, START_NS, write_long_recording
from range_server import RangeServer, range_server

import lidcam.readers.files.remote as remote
from lidcam.pipeline.core.errors import RecordingError
from lidcam.readers.files.remote import PAGE_BYTES, open_remote
from lidcam.readers.location import RemotePath
from lidcam.readers.open import open_recording
from lidcam.readers.recording import DEFAULT_READ_OPTIONS, ReadOptions


@pytest.fixture(scope="module")
def minute(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("remote") / "minute.mcap"
    write_long_recording(path)
    return path


@pytest.fixture(scope="module")
def content(minute: Path) -> bytes:
    return minute.read_bytes()


@pytest.fixture
def server(content: bytes) -> Iterator[RangeServer]:
    with range_server({"/minute.mcap": content}) as state:
        yield state


@pytest.fixture(autouse=True)
def _impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(remote, "RETRY_DELAYS_S", (0.0, 0.0, 0.0))


@pytest.fixture(autouse=True, scope="module")
def _nothing_left_open() -> Iterator[None]:
    """A connection that is left to the garbage collector warns, and warnings are errors."""
    yield
    gc.collect()


def at(server: RangeServer, path: str = "/minute.mcap") -> RemotePath:
    return RemotePath(server.url + path)


def error_of(path: RemotePath, options: ReadOptions = DEFAULT_READ_OPTIONS) -> str:
    with pytest.raises(RecordingError) as caught, open_recording([path], options) as recording:
        list(recording.messages())
    return str(caught.value)


def taken(path: Path | RemotePath, start_s: float, stop_s: float, topics: list[str] | None = None) -> list[Any]:
    with open_recording([path]) as recording:
        start_ns, stop_ns = START_NS + round(start_s * SECOND_NS), START_NS + round(stop_s * SECOND_NS)
        messages = recording.messages(topics, start_ns=start_ns, stop_ns=stop_ns)
        return [(m.topic, m.stamp_ns, m.log_time_ns, m.order, bytes(m.data), m.channel) for m in messages]


def test_window_of_a_long_recording_fetches_little(server: RangeServer, minute: Path, content: bytes) -> None:
    got = taken(at(server), 30, 35)
    assert got == taken(minute, 30, 35)
    assert len(got) == 300
    assert server.sent < 0.12 * len(content)
    assert len(server.requests) < 15


def test_all_of_it_in_few_requests_none_twice(server: RangeServer, minute: Path, content: bytes) -> None:
    assert taken(at(server), 0, LENGTH_S) == taken(minute, 0, LENGTH_S)
    assert server.sent <= len(content) + PAGE_BYTES
    assert len(server.requests) < 30


@given(
    size=st.integers(0, 3 * PAGE_BYTES),
    reads=st.lists(st.tuples(st.integers(0, 3 * PAGE_BYTES), st.integers(0, 2 * PAGE_BYTES)), max_size=8),
)
def test_reads_like_the_file(size: int, reads: list[tuple[int, int]]) -> None:
    content = np.random.default_rng(size).bytes(size)
    fsspec.filesystem("memory").pipe("/any", content)
    with patch.dict(remote.EXTRAS, memory=""):
        _, stream = open_remote(RemotePath("memory://any"))
    with stream, io.BytesIO(content) as expected:
        for position, count in reads:
            assert stream.seek(position) == expected.seek(position)
            assert stream.read(count) == expected.read(count)
            assert stream.tell() == expected.tell()
        assert stream.seek(0, 2) == size
        assert stream.read() == b""


# --- servers


def test_lost_connections_are_made_up_for(server: RangeServer, minute: Path) -> None:
    server.drops, server.failures = 2, 1
    assert taken(at(server), 10, 12) == taken(minute, 10, 12)
    assert server.drops == server.failures == 0


LOST = "the connection was lost at byte "
NO_RANGES = "its server does not give parts of a file (range requests);"


def status(number: int) -> dict[str, Any]:
    return {"statuses": {"/minute.mcap": number}}


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        (status(404), "no such file (HTTP 404); check the address"),
        ({"drops": 10**6}, LOST),
        ({"failures": 10**6}, LOST),
        ({"too_many": -5}, LOST),
        ({"gives_ranges": False}, f"{NO_RANGES} download it, and"),
        ({"redirects": {"/minute.mcap": "file:///etc/passwd"}}, "NonHttpUrlRedirectClientError; check the address"),
        ({"redirects": {"/minute.mcap": "/minute.mcap"}}, "TooManyRedirects; check the address"),
    ],
    ids=str,
)
def test_a_server_that_goes_wrong_is_told_in_one_line(server: RangeServer, changes: dict[str, Any], told: str) -> None:
    path = RemotePath(f"{server.url}/minute.mcap?sig=s3cret")
    with open_recording([path]) as recording:
        for name, value in changes.items():
            setattr(server, name, value)
        with pytest.raises(RecordingError) as caught:
            list(recording.messages())
    assert str(caught.value).startswith(f"{server.url}/minute.mcap?...: {told}")
    assert "\n" not in str(caught.value)
    if told == LOST:
        assert str(caught.value).endswith("4 attempts); check the network, and try again")


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        (status(401), "access was denied (HTTP 401); check the credentials, and whether a signed link is still valid"),
        (status(404), "no such file (HTTP 404); check the address"),
        (status(418), "HTTP 418; try again later, or download it, and read the copy"),
        (status(500), "it cannot be opened (HTTP 500, 4 attempts); check the network, and try again"),
        ({"gives_ranges": False, "says_so": True}, f"{NO_RANGES} download it, and read the copy"),
    ],
)
def test_a_server_that_refuses(server: RangeServer, changes: dict[str, Any], expected: str) -> None:
    for name, value in changes.items():
        setattr(server, name, value)
    assert error_of(at(server)) == f"{server.url}/minute.mcap: {expected}"


def test_redirects_are_followed_without_a_password(server: RangeServer, minute: Path) -> None:
    with range_server() as first:
        first.redirects["/latest"] = f"{server.url}/minute.mcap"
        url = first.url.replace("://", "://ada:s3cret@")
        assert taken(RemotePath(f"{url}/latest"), 10, 11) == taken(minute, 10, 11)
        assert all(request.authorization for request in first.requests)
    assert server.requests
    assert not any(request.authorization for request in server.requests)


@pytest.mark.parametrize("told_by", ["etag", "time", ""])
def test_a_file_that_is_written_anew_while_it_is_read(server: RangeServer, told_by: str) -> None:
    server.has_etag = told_by == "etag"
    server.modified = server.modified if told_by else ""
    path = at(server)
    with open_recording([path]) as recording:
        server.files["/minute.mcap"] = Random(0).randbytes(len(server.files["/minute.mcap"]))
        server.modified = "Mon, 01 Jan 2024 00:00:00 GMT" if told_by == "time" else server.modified
        if told_by:
            with pytest.raises(RecordingError, match=r"it was changed while it was read \(HTTP 412\)"):
                list(recording.messages())
        else:  # nothing tells but the content itself
            assert len(list(recording.messages())) < 100
            assert recording.losses


# --- credentials


def test_user_and_password_are_sent_and_never_shown(server: RangeServer, minute: Path) -> None:
    server.password = base64.b64encode(b"ada:s3cret").decode()
    secret = RemotePath(server.url.replace("://", "://ada:s3cret@") + "/minute.mcap?X-Amz-Signature=abc%2Fdef#x")
    assert taken(secret, 10, 11) == taken(minute, 10, 11)
    assert all(request.target == "/minute.mcap?X-Amz-Signature=abc%2Fdef" for request in server.requests)
    with open_recording([secret]) as recording:
        assert "s3cret" not in f"{recording.paths!r} {recording.paths[0]}"
        server.password = "changed"
        with pytest.raises(RecordingError) as caught:
            list(recording.messages())
    error: BaseException | None = caught.value
    assert error is not None
    assert str(error).startswith(f"{server.url}/minute.mcap?...: access was denied (HTTP 401)")
    assert error.__suppress_context__
    assert error.__cause__ is None


# --- files


def test_a_truncated_file_is_read_as_a_whole_after_a_warning(
    server: RangeServer, content: bytes, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    cut = content[: len(content) // 3]
    server.files["/cut.mcap"] = cut
    (tmp_path / "cut.mcap").write_bytes(cut)
    assert taken(at(server, "/cut.mcap"), 5, 10) == taken(tmp_path / "cut.mcap", 5, 10)
    (warning,) = caplog.messages
    assert warning.startswith(f"{server.url}/cut.mcap: its summary cannot be used (")
    assert warning.endswith(f"all of it is fetched, {len(cut) / 1e6:.1f} MB")
    assert server.sent <= len(cut) + PAGE_BYTES
    assert len(server.requests) < 20
    with open_recording([at(server, "/cut.mcap")]) as recording, open_recording([tmp_path / "cut.mcap"]) as local:
        assert [loss.reason for loss in recording.losses] == [loss.reason for loss in local.losses]
    assert "without `--on-bad-message fail`" in error_of(at(server, "/cut.mcap"), ReadOptions("none"))


@pytest.mark.parametrize(
    ("begin", "kind"),
    [
        (b"#ROSBAG V2.0\n", "a ROS 1 bag"),
        (b"SQLite format 3\0", "an SQLite database"),
        (b"\x28\xb5\x2f\xfd", "a compressed file"),
        (b"<html>not here</html>", "another kind of file"),
    ],
)
def test_other_formats_are_to_be_downloaded(server: RangeServer, begin: bytes, kind: str) -> None:
    server.files["/some"] = begin + bytes(100)
    assert error_of(at(server, "/some")) == (
        f"{server.url}/some: of files on a server, lidcam reads .mcap, found {kind}; download it, and read the copy"
    )


# --- protocols


@pytest.mark.parametrize(
    ("url", "expected"),
    [
        ("http://[bad/rec.mcap", "its address cannot be used; check the address"),
        ("https://host:99999/rec.mcap", "its address cannot be used; check the address"),
        ("ftp://host/a.mcap", "ftp://host/a.mcap: lidcam reads https://, http:// and s3://, found ftp://"),
        ("x://a:s3cret@host/a.mcap", "x://host/a.mcap: lidcam reads https://, http:// and s3://, found x://"),
    ],
)
def test_addresses_that_lead_nowhere(url: str, expected: str) -> None:
    assert error_of(RemotePath(url)).endswith(expected)


@pytest.mark.parametrize(("protocol", "module", "extra"), [("https", "aiohttp", "http"), ("s3", "s3fs", "s3")])
def test_what_is_not_installed_is_named(
    monkeypatch: pytest.MonkeyPatch, protocol: str, module: str, extra: str
) -> None:
    monkeypatch.setitem(sys.modules, module, None)
    monkeypatch.delitem(sys.modules["fsspec.registry"]._registry, protocol, raising=False)  # another test's
    reason = f"{protocol}:// needs a library that is not installed: pip install 'lidcam[{extra}]'"
    assert error_of(RemotePath(f"{protocol}://host/rec.mcap")) == f"{protocol}://host/rec.mcap: {reason}"
