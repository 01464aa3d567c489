from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx.external_data_helper import set_external_data
from onnx_files import Shape, write_convolutional, write_network, write_yolox

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


def test_a_fixed_network_of_convolutions_takes_each_images_shape(tmp_path: Path) -> None:
    path = convolutional(tmp_path / "m.onnx")
    given = sizes_given(path, (375, 1242), (480, 640), (376, 1242), (10, 10))
    assert given == [(384, 1248), (384, 1248), (480, 640), (32, 32)], "their own size"
    assert sizes_given(path, (1080, 1920)) == [(736, 1312)], "scaled to a million pixels"
    assert sizes_given(path, (375, 1242), (480, 640), input=(320, 224)) == [(224, 320)] * 2
    assert sizes_given(path, (375, 1242), input=(96, 64)) == [(64, 96)]


def test_a_network_with_tables_keeps_its_size(tmp_path: Path) -> None:
    path = write_yolox(tmp_path / "m.onnx", np.full((126, 85), 0.5, np.float32), size_px=(64, 96))
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


@pytest.mark.parametrize(
    ("rows", "size_px", "metadata", "given"),
    [
        pytest.param((300, 84), (64, 96), {}, (64, 96), id="made for one size by its kind"),
        pytest.param((300, 84), ("height", "width"), {}, (384, 1248), id="free"),
        pytest.param((84, 126), ("height", "width"), {"imgsz": "[64, 96]", "stride": "32"}, (64, 96), id="a table"),
    ],
)
def test_what_a_file_says_of_its_size(
    tmp_path: Path, rows: tuple[int, int], size_px: Shape, metadata: dict[str, str], given: tuple[int, int]
) -> None:
    outputs = {"output0": np.full(rows, 0.5, np.float32)}
    path = write_network(tmp_path / "m.onnx", outputs, size_px=size_px, batch="N", metadata=metadata)
    assert {*sizes_given(path, (375, 1242))} == {given}


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


@pytest.mark.parametrize("location", ["../outside.bin", "link.bin", "inside.bin", "{absolute}"])
def test_weights_in_other_files(tmp_path: Path, location: str) -> None:
    """Only beside the model, also of a network that was changed; links do not lead out."""
    folder = tmp_path / "model"
    folder.mkdir()
    weights = np.full(85, 0.25, np.float32)
    weights.tofile(tmp_path / "outside.bin")
    weights.tofile(folder / "inside.bin")
    (folder / "link.bin").symlink_to("../outside.bin")
    path = convolutional(folder / "a.onnx")
    loaded, model = OnnxSession(path), onnx.load(path)
    (bias,) = (one for one in model.graph.initializer if one.name == "bias32")
    set_external_data(bias, location.format(absolute=tmp_path / "outside.bin"), offset=0, length=340)
    bias.ClearField("raw_data")
    path.write_bytes(model.SerializeToString())
    if location == "inside.bin":
        changed = loaded.with_free_size("images")
        assert float(changed.run({"images": np.zeros((1, 3, 32, 32), np.float32)}, 1)[0][0, -1, 0]) == 0.25
        return
    for load in (partial(OnnxSession, path), partial(loaded.with_free_size, "images")):
        with pytest.raises(ModelError, match="expected an ONNX file that onnxruntime can load"):
            load()
