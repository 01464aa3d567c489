from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from onnx_files import FLOAT, _bytes, _tensor, _varint_field, write_yolox
from onnx_networks import write_convolutional, write_network

from lidcam.pipeline.core.arrays import Array
from lidcam.pipeline.core.errors import ModelError
from lidcam.pipeline.core.settings.detect import Detect2DConfig
from lidcam.pipeline.detectors.onnx import session
from lidcam.pipeline.detectors.onnx.detector import OnnxDetector2D
from lidcam.pipeline.detectors.onnx.free_size import free_size
from lidcam.pipeline.detectors.onnx.session import OnnxSession


def convolutional(path: Path) -> Path:
    strides = (8, 16, 32)
    kernels = [np.zeros((85, 3, stride, stride)) for stride in strides]
    return write_convolutional(path, kernels, [np.full(85, 0.5)] * 3, size_px=(64, 96))


def tabular(path: Path) -> Path:
    return write_yolox(path, np.full((126, 85), 0.5, np.float32), size_px=(64, 96))


def sizes_given(path: Path, *shapes: tuple[int, int], **settings: object) -> list[tuple[int, ...]]:
    """Heights and widths that a network is given for images (height, width)."""
    model = OnnxDetector2D(path, Detect2DConfig.model_validate(settings))
    given: list[tuple[int, ...]] = []
    run: Callable[..., list[Array]] = OnnxSession.run

    def watched(one: OnnxSession, fed: dict[str, Array], images: int) -> list[Array]:
        given.append(fed["images"].shape[2:])
        return run(one, fed, images)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(OnnxSession, "run", watched)
        model([np.zeros((*shape, 3), np.uint8) for shape in shapes])
    return given


def test_a_fixed_network_of_convolutions_takes_each_pictures_shape(tmp_path: Path) -> None:
    path = convolutional(tmp_path / "m.onnx")
    given = sizes_given(path, (375, 1242), (480, 640), (376, 1242), (10, 10))
    assert given == [(384, 1248), (384, 1248), (480, 640), (32, 32)], "their own size"
    assert sizes_given(path, (1080, 1920)) == [(736, 1312)], "scaled to a million pixels"
    assert sizes_given(path, (375, 1242), (480, 640), input=(320, 224)) == [(224, 320)] * 2
    assert sizes_given(path, (375, 1242), input=(96, 64)) == [(64, 96)]


def test_a_network_with_tables_keeps_its_size(tmp_path: Path) -> None:
    path = tabular(tmp_path / "m.onnx")
    assert sizes_given(path, (64, 96), (100, 150)) == [(64, 96)] * 2
    assert sizes_given(path, (375, 1242)) == [(64, 96)] * 3, "in tiles"
    with pytest.raises(ModelError, match=r"detect2d\.input: the network does not take 128 x 64 px, its own .* 96 x 64"):
        OnnxDetector2D(path, Detect2DConfig(input=(128, 64)))


def test_sizes_are_multiples_of_the_stride(tmp_path: Path) -> None:
    path = convolutional(tmp_path / "m.onnx")
    with pytest.raises(ModelError, match="expected multiples of 32 px, found 100 x 64"):
        OnnxDetector2D(path, Detect2DConfig(input=(100, 64)))
    with pytest.raises(ModelError, match=r"GiB, expected at most 0\.5 GiB"):
        OnnxDetector2D(path, Detect2DConfig(input=(1 << 16, 1 << 16)))


def test_a_network_for_one_size_by_its_kind_keeps_it(tmp_path: Path) -> None:
    outputs = {"output0": np.full((300, 84), 0.5, np.float32)}
    path = write_network(tmp_path / "m.onnx", outputs, size_px=(64, 96), batch="N")
    assert sizes_given(path, (100, 150)) == [(64, 96)]
    path = write_network(tmp_path / "m.onnx", outputs, size_px=("height", "width"), batch="N")
    assert sizes_given(path, (375, 1242)) == [(384, 1248)]


def test_what_the_file_says_of_its_size(tmp_path: Path) -> None:
    outputs = {"output0": np.full((84, 126), 0.5, np.float32)}
    said = {"imgsz": "[64, 96]", "stride": "32"}
    path = write_network(tmp_path / "m.onnx", outputs, size_px=("height", "width"), batch="N", metadata=said)
    assert sizes_given(path, (100, 150)) == [(64, 96)], "a table for this size is in it"


def test_a_large_file_is_not_changed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = convolutional(tmp_path / "m.onnx")
    monkeypatch.setattr(session, "MAX_CHANGED_BYTES", 1000)
    assert sizes_given(path, (100, 150)) == [(64, 96)]


@pytest.mark.parametrize("data", [b"", b"\x3a\xff", b"this is no network", b"\x3a\x00"])
def test_other_files(data: bytes) -> None:
    with pytest.raises(ModelError):
        free_size(data, "images")


def test_the_rest_of_a_file_stays(tmp_path: Path) -> None:
    data = convolutional(tmp_path / "m.onnx").read_bytes()
    changed = free_size(data, "images")
    assert free_size(changed, "images") == changed
    assert b"kernel32" in changed
    assert len(changed) < len(data)


@pytest.mark.parametrize(
    "location", ["../outside.bin", "link.bin", "inside.bin", "{absolute}", "./x/../../outside.bin"]
)
def test_weights_in_other_files(tmp_path: Path, location: str) -> None:
    """Only beside the model, also of a network that was changed; links do not lead out."""
    folder = tmp_path / "model"
    folder.mkdir()
    weights = np.full(85, 0.25, np.float32)
    weights.tofile(tmp_path / "outside.bin")
    weights.tofile(folder / "inside.bin")
    (folder / "link.bin").symlink_to("../outside.bin")
    entries = {"location": location.format(absolute=tmp_path / "outside.bin"), "offset": "0", "length": "340"}
    stored = b"".join(_bytes(13, _bytes(1, k.encode()) + _bytes(2, v.encode())) for k, v in entries.items())
    inside = _tensor("bias32", np.full(85, 0.5, np.float32), FLOAT)
    outside = _varint_field(1, 85) + _varint_field(2, FLOAT) + _bytes(8, b"bias32") + stored + _varint_field(14, 1)
    path = convolutional(folder / "a.onnx")
    loaded = OnnxSession(path, threads=1, provider="cpu")
    head, graph = graph_of(path.read_bytes())
    assert _bytes(5, inside) in graph
    path.write_bytes(head + _bytes(7, graph.replace(_bytes(5, inside), _bytes(5, outside))))
    if location == "inside.bin":
        OnnxSession(path, threads=1, provider="cpu")
        changed = loaded.with_free_size("images")
        fed = {"images": np.zeros((1, 3, 32, 32), np.float32)}
        assert float(changed.run(fed, 1)[0][0, -1, 0]) == 0.25
    else:
        fault = "expected an ONNX file that onnxruntime can load"
        with pytest.raises(ModelError, match=fault):
            OnnxSession(path, threads=1, provider="cpu")
        with pytest.raises(ModelError, match=fault):
            loaded.with_free_size("images")


def graph_of(model: bytes) -> tuple[bytes, bytes]:
    """What comes before the graph, which is the last field of a model that is made here, and the graph."""
    head = _varint_field(1, 6) + _bytes(8, _varint_field(2, 11))
    at = len(head) + 1
    while model[at] & 0x80:
        at += 1
    return head, model[at + 1 :]
