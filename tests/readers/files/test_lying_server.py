"""A server that lies is told in one line, before what it sends fills memory."""

import resource
import time
from pathlib import Path

import pytest
from builders import raw, write_mcap
from lying_server import LIES, Answer, LyingServer, lying_server

import readers.files.remote as remote
from pipeline.core.errors import RecordingError
from pipeline.core.settings.recording import LimitsConfig
from readers.files.web import WebFacts
from readers.location import RemotePath
from readers.open import open_recording
from readers.recording import ReadOptions

MORE = "its server sends more than it was asked for; download it, and read the copy"
OTHER = "its server answers with another part than it was asked for; download it, and read the copy"
CHANGED = "it was changed while it was read; read it again when it is complete"
NOT_HTTP = "its server redirects to something else than http:// and https://; check the address"
SLOW = "its server took more than 1 s for one request; download it, and read the copy, or raise limits.max_request_s"
COMPRESSES = "its server compresses what it sends, though it was asked not to; download it, and read the copy"


@pytest.fixture(scope="module")
def content(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    path = tmp_path_factory.mktemp("lying") / "a.mcap"
    texts = [raw("/a", "std_msgs/msg/String", {"data": f"{i:05}" * 1000}, i) for i in range(1, 60)]
    write_mcap(path, texts, "none", chunk_bytes=1 << 14)
    return path.read_bytes()


@pytest.fixture(autouse=True)
def _impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(remote, "RETRY_DELAYS_S", (0.0, 0.0, 0.0))


def read(content: bytes, lies: list[str]) -> list[bytes]:
    """What is read of a file, where the server tells the truth about the first two requests."""
    options = ReadOptions("none", LimitsConfig(max_request_s=1.0))
    with lying_server(content, ["truth", "truth", *lies]) as server:
        try:
            with open_recording([RemotePath(f"{server.url}/a.mcap?sig=s3cret")], options) as recording:
                return [bytes(message.data) for message in recording.messages()]
        except RecordingError as err:
            raise RecordingError(str(err).removeprefix(f"{server.url}/a.mcap?...: ")) from None


@pytest.mark.parametrize(
    ("lie", "told"),
    [
        ("status 404 Not Found", "no such file (HTTP 404); check the address"),
        ("another etag", CHANGED),
        ("another time", CHANGED),
        ("another size", CHANGED),
        ("an endless body", MORE),
        ("an endless body in chunks", MORE),
        ("a body that is too long", MORE),
        ("a body that drips", SLOW),
        ("a head that drips", SLOW),
        ("an endless number of interim answers", SLOW),
        ("a compressed body", COMPRESSES),
        ("a compressed body of zeros", COMPRESSES),
        ("another part", OTHER),
        ("a part without its place", OTHER),
        ("several parts", OTHER),
        ("the whole file", "its server does not give parts of a file (range requests); download it, and read the copy"),
        ("a redirect to file:///etc/passwd", NOT_HTTP),
        ("a redirect to ftp://127.0.0.1/x", NOT_HTTP),
        ("a redirect to data:text/plain,x", NOT_HTTP),
        ("a redirect to {url}/again", "its server redirects again and again; check the address"),
        (
            "bytes that are no HTTP",
            "its server answers with something else than HTTP; check the address, or download it, and read the copy",
        ),
    ],
)
def test_lies_are_told(content: bytes, lie: str, told: str) -> None:

    before_mib, began_s = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss >> 10, time.monotonic()
    with pytest.raises(RecordingError) as caught:
        read(content, [lie])
    assert str(caught.value) == told  # and so shows no secret
    assert time.monotonic() - began_s < 10
    assert (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss >> 10) - before_mib < 60


@pytest.mark.parametrize("lie", ["no answer", "a body that is cut off", "a body that is too short", "status 503 Busy"])
def test_what_may_pass_is_asked_again(content: bytes, lie: str) -> None:
    assert len(read(content, [lie, "truth"])) == 59
    with pytest.raises(RecordingError, match=r"the connection was lost at byte \d+ \(.*, 4 attempts\); "):
        read(content, [lie])


def test_a_file_without_parts_that_is_fetched_whole(content: bytes, tmp_path: Path) -> None:
    write_mcap(tmp_path / "small.mcap", [raw("/a", "std_msgs/msg/String", {"data": "b"}, 1)], "none")
    small = (tmp_path / "small.mcap").read_bytes()
    assert len(read(small, ["the whole file"])) == 1
    with pytest.raises(RecordingError, match="does not give parts"):
        read(content, ["the whole file"])


def test_a_redirect_hands_no_password_on(content: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    with lying_server(content) as other, lying_server(content) as server:

        def redirect(answer: Answer, _: LyingServer) -> None:
            answer.status, answer.body = b"302 Found", b""
            answer.headers = {"Location": f"{other.url}/b.mcap", "Content-Length": "0"}

        monkeypatch.setitem(LIES, "a redirect to another host", redirect)
        server.lies = ["a redirect to another host"]
        url = server.url.replace("://", "://ada:s3cret@") + "/a.mcap"
        with open_recording([RemotePath(url)]) as recording:
            assert len(list(recording.messages())) == 59
        assert all("Authorization: Basic" in head for head in server.requests)
        assert other.requests
        assert not any("authorization" in head.lower() for head in other.requests)


def test_a_slow_server_is_asked_for_less(content: bytes) -> None:
    with lying_server(content) as server:
        file = remote.RemoteFile(RemotePath(f"{server.url}/a.mcap"), LimitsConfig(max_request_s=10))
        with file:
            file._adapt(1 << 16, 1.0)
            assert file._max_pages == 2
            file._adapt(1 << 16, 100.0)
            assert file._max_pages == 1
            file._adapt(1 << 23, 0.0)
            assert file._max_pages == remote.MAX_REQUEST_PAGES


def test_conditions_of_a_part() -> None:
    assert WebFacts(1, '"a"', "now", has_ranges=True).conditions == {"If-Match": '"a"'}
    assert WebFacts(1, 'W/"a"', "now", has_ranges=True).conditions == {"If-Unmodified-Since": "now"}
    assert WebFacts(1, "", "", has_ranges=True).conditions == {}
