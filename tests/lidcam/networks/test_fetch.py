"""`lidcam fetch`, from a server on this machine in place of the maker's."""

import hashlib
import socket
from collections.abc import Callable, Iterator
from dataclasses import replace
from http.client import HTTPMessage
from io import BytesIO
from itertools import islice
from pathlib import Path
from urllib.error import URLError
from urllib.request import Request

import numpy as np
import pytest
from builders import write_rosbag1
from command import Run, called
from helpers import CLUSTERS, SANDBOX
from onnx_files import write_yolox
from range_server import RangeServer, range_server

from lidcam.networks.fetch import _SafeRedirects
from lidcam.networks.known import NETWORKS, network_path, networks_folder
from lidcam.pipeline.core.errors import ModelError
from lidcam.readers.open import open_recording
from lidcam.readers.results.result import open_result
from lidcam.readers.rig.sensor_topics import BOXES

NAME = "yolox-nano"
PART = ("--config", "sandbox", "--duration", "0.2", "--set", CLUSTERS)


@pytest.fixture
def server(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[RangeServer]:
    """A server that publishes a network, which the table then knows under `NAME`."""
    data = write_yolox(tmp_path / "n.onnx", np.zeros((84, 85), np.float32), size_px=(64, 64)).read_bytes()
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))
    for variable in ("http_proxy", "HTTP_PROXY", "all_proxy"):
        monkeypatch.delenv(variable, raising=False)
    with range_server({"/yolox_nano.onnx": data}) as running:
        publish(monkeypatch, f"{running.url}/yolox_nano.onnx", data)
        yield running


def publish(monkeypatch: pytest.MonkeyPatch, address: str, data: bytes) -> None:
    digest = hashlib.sha256(data).hexdigest()
    known = replace(NETWORKS[NAME], address=address, size_bytes=len(data), sha256=digest)
    monkeypatch.setitem(NETWORKS, NAME, known)


def process(folder: Path) -> Run:
    return called(folder, "process", SANDBOX, "out.mcap", "--model-2d", NAME, *PART, "--workers", "1", "--json")


def test_a_network_is_fetched_once_and_only_on_request(server: RangeServer, tmp_path: Path) -> None:
    missing = process(tmp_path)
    assert (missing.code, server.requests) == (1, [])
    assert missing.error_line.endswith("yolox-nano: is not on this machine yet: run lidcam fetch yolox-nano")

    server.redirects["/yolox_nano.onnx"] = "/elsewhere.onnx"  # as GitHub does
    server.files["/elsewhere.onnx"] = server.files["/yolox_nano.onnx"]
    done = called(tmp_path, "fetch", NAME)
    path = networks_folder() / "yolox_nano.onnx"
    assert (done.code, done.err) == (0, f"wrote {path}\n")
    assert NETWORKS[NAME].address in done.out
    assert "licence Apache-2.0: https://" in done.out
    assert path.read_bytes() == server.files["/elsewhere.onnx"]

    asked = len(server.requests)
    assert called(tmp_path, "fetch", NAME).err == f"{path} already exists\n"
    used = process(tmp_path)
    assert used.code == 0, used.err
    with open_result(tmp_path / "out.mcap") as result:
        assert (result.metadata["network.name"], result.metadata["network.sha256"]) == (
            path.name,
            NETWORKS[NAME].sha256,
        )
    assert len(server.requests) == asked

    path.write_bytes(b"damaged")
    assert called(tmp_path, "fetch", NAME).code == 0
    assert path.read_bytes() == server.files["/elsewhere.onnx"]


def test_what_was_fetched_is_used_where_no_boxes_are_recorded(server: RangeServer, tmp_path: Path) -> None:
    with open_recording([SANDBOX]) as recording:
        topics = [info.topic for info in recording.topics if info.msgtype not in BOXES]
        write_rosbag1(tmp_path / "i.bag", islice(recording.messages(topics), 100))

    def run(path: Path, *options: str) -> str:
        done = called(tmp_path, "process", path, "o.mcap", *PART, *options)
        assert done.code == 0, done.err
        return done.out

    advice = "The cameras are not used. Type `lidcam fetch yolox-nano`, then run this again.\n"
    assert run(tmp_path / "i.bag").startswith(advice)
    assert called(tmp_path, "inspect", "i.bag").out.startswith(advice)
    assert "The cameras" not in run(SANDBOX)
    before = (tmp_path / "o.mcap").read_bytes()
    path = network_path(Path(NAME))
    path.parent.mkdir(parents=True)
    path.write_bytes(server.files["/yolox_nano.onnx"])
    assert "2D boxes: network yolox-nano\n" in run(tmp_path / "i.bag")
    with open_result(tmp_path / "o.mcap") as result:
        assert result.config.detect2d.model == Path(NAME)
        assert result.metadata["network.sha256"] == NETWORKS[NAME].sha256
    sled = "classes=[{name: sled, size_m: [1, 1, 1], max_size_m: [2, 2, 2]}]"  # which COCO does not know
    for options in (("--model-2d", "none"), ("--set", sled)):
        said = run(tmp_path / "i.bag", *options)
        assert "none (lidar-only)" in said
        assert "The cameras" not in said
    run(SANDBOX)
    assert (tmp_path / "o.mcap").read_bytes() == before


CASES: dict[str, tuple[Callable[[RangeServer, bytes], object], str]] = {
    "another file": (
        lambda s, data: s.files.update({"/yolox_nano.onnx": bytes([data[0] ^ 1]) + data[1:]}),
        "expected SHA-256",
    ),
    "too large": (lambda s, data: s.files.update({"/yolox_nano.onnx": data + b"x"}), "bytes, found more"),
    "cut": (lambda s, _: setattr(s, "drops", 1), "bytes, found"),
    "not there": (lambda s, _: s.statuses.update({"/yolox_nano.onnx": 404}), "the server answers 404 Not Found"),
    "elsewhere": (
        lambda s, _: s.redirects.update({"/yolox_nano.onnx": "ftp://host/n.onnx"}),
        "it leads to ftp://host, and not to https",
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_what_is_not_the_network_is_not_kept(server: RangeServer, tmp_path: Path, case: str) -> None:
    spoil, fault = CASES[case]
    spoil(server, server.files["/yolox_nano.onnx"])
    done = called(tmp_path, "fetch", NAME)
    path = networks_folder() / "yolox_nano.onnx"
    assert done.code == 1
    assert fault in done.error_line
    assert done.error_line.startswith(f"lidcam: error: {NETWORKS[NAME].address}: ")
    assert done.error_line.endswith(f"download it by hand and save it as {path}")
    assert not (tmp_path / "data").exists()


@pytest.mark.usefixtures("server")
def test_no_server_listens(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with socket.socket() as unused:
        unused.bind(("127.0.0.1", 0))
        publish(monkeypatch, f"http://127.0.0.1:{unused.getsockname()[1]}/yolox_nano.onnx", b"n")
        done = called(tmp_path, "fetch", NAME)
    assert done.code == 1
    assert "Connection refused; nothing was written" in done.error_line


def test_nothing_leads_from_https_to_http() -> None:
    redirects, request = _SafeRedirects(), Request("https://github.com/n.onnx")
    followed = redirects.redirect_request(request, BytesIO(), 302, "", HTTPMessage(), "https://other/n.onnx")
    assert followed is not None
    with pytest.raises(URLError, match="leads to http://other, and not to https"):
        redirects.redirect_request(request, BytesIO(), 302, "", HTTPMessage(), "http://other/n.onnx")


def test_where_networks_lie(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    for data, folder in (("/data", "/data"), ("", f"{tmp_path}/.local/share"), ("data", f"{tmp_path}/.local/share")):
        monkeypatch.setenv("XDG_DATA_HOME", data)
        assert network_path(Path("yolox-s")) == Path(folder, "lidcam/networks/yolox_s.onnx")
    assert network_path(Path("a/yolox-s")) == Path("a/yolox-s")
    monkeypatch.setattr(Path, "home", lambda: (_ for _ in ()).throw(RuntimeError("none")))
    with pytest.raises(ModelError, match="let XDG_DATA_HOME name a folder"):
        network_path(Path("yolox-s"))
