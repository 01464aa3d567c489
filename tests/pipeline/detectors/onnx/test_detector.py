import logging
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from onnx_files import write_network, write_yolox

from lidcam.pipeline.core.arrays import U8, Array
from lidcam.pipeline.core.errors import ModelError
from lidcam.pipeline.core.settings.detect import Detect2DConfig
from lidcam.pipeline.detectors.onnx import detector as onnx_detector
from lidcam.pipeline.detectors.onnx.detector import OnnxDetector2D
from lidcam.pipeline.detectors.onnx.session import OnnxSession

SIZE_PX = (64, 96)  # height, width of the networks that are made here
ANCHORS = 8 * 12 + 4 * 6 + 2 * 3


def raw_rows(seed: int = 0) -> Array:
    """Rows as a YOLOX head gives them: offsets, logarithms, then scores in [0, 1]."""
    rng = np.random.default_rng(seed)
    return np.concatenate(
        [rng.uniform(-1, 2, (ANCHORS, 2)), rng.normal(0, 1, (ANCHORS, 2)), rng.uniform(0, 1, (ANCHORS, 81))], 1
    ).astype(np.float32)


def image(height: int, width: int, rgb: tuple[int, int, int] = (0, 0, 0)) -> U8:
    return np.full((height, width, 3), rgb, np.uint8)


def detector(path: Path) -> OnnxDetector2D:
    """A network that is given whole images in its own size, and of which every box is wanted."""
    return OnnxDetector2D(path, Detect2DConfig(input=SIZE_PX[::-1], min_score=0))


@pytest.mark.parametrize("channel", [0, 2])
def test_network_sees_blue_green_red_from_0_to_255(tmp_path: Path, channel: int) -> None:
    rows, weight = raw_rows(), np.zeros((ANCHORS, 85))
    rows[:, 4], weight[:, 4], rows[:, 5] = 0, 1, 1
    rows[:, 6:] = 0
    one_channel = [float(c == channel) for c in range(3)]
    path = write_yolox(tmp_path / "m.onnx", rows, size_px=SIZE_PX, weight=weight, channel_weights=one_channel)
    (found,) = detector(path)([image(128, 192, rgb=(30, 20, 10))])
    np.testing.assert_allclose(found.scores, (10, 20, 30)[channel], rtol=1e-5)


@pytest.mark.parametrize("count", [0, 1, 5])
def test_batches_change_nothing(tmp_path: Path, count: int) -> None:
    rows, weight = raw_rows(), np.zeros((ANCHORS, 85))
    weight[:, 4] = 1 / 255
    images = [image(40 + 7 * i, 60 + 5 * i, rgb=(50 * i, 20, 5 * i)) for i in range(count)]
    found = {
        batch: detector(write_yolox(tmp_path / f"{batch}.onnx", rows, size_px=SIZE_PX, batch=batch, weight=weight))(
            images
        )
        for batch in (1, 2, 4, "batch")
    }
    assert all(len(candidates) == count for candidates in found.values())
    for batch in (2, 4, "batch"):
        for single, batched in zip(found[1], found[batch], strict=True):
            for expected, got in zip(single, batched, strict=True):
                np.testing.assert_array_equal(got, expected)
    brightness = [c.scores.sum() for c in found["batch"]]
    assert brightness == sorted(set(brightness)), "each image has its own result"


def test_a_free_batch_runs_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    free = detector(write_yolox(tmp_path / "free.onnx", raw_rows(), size_px=SIZE_PX, batch="n"))
    sizes: list[int] = []
    run: Callable[[OnnxSession, Mapping[str, Array], int], list[Array]] = OnnxSession.run

    def counted(session: OnnxSession, fed: Mapping[str, Array], images: int) -> list[Array]:
        sizes.append(len(fed["images"]))
        return run(session, fed, images)

    monkeypatch.setattr(OnnxSession, "run", counted)
    free([image(20, 30)] * 3)
    monkeypatch.setattr(onnx_detector, "CACHED_BYTES", 2 * onnx_detector.PIXEL_BYTES * SIZE_PX[0] * SIZE_PX[1])
    free([image(20, 30)] * 5)
    assert sizes == [3, 2, 2, 1], "as many as the processor's caches hold"


def folder(path: Path) -> None:
    path.mkdir()


def cut(path: Path) -> None:
    write_yolox(path, raw_rows(), size_px=SIZE_PX)
    path.write_bytes(path.read_bytes()[:5000])


def network(rows: Array, *, size_px: tuple[int, int] = SIZE_PX, **settings: Any) -> Callable[[Path], object]:
    return lambda path: write_yolox(path, rows, size_px=size_px, **settings)


def for_task(task: str) -> Callable[[Path], object]:
    rows, metadata = {"output0": np.zeros((56, ANCHORS), np.float32)}, {"task": task, "names": "{0: 'person'}"}
    return lambda path: write_network(path, rows, size_px=SIZE_PX, metadata=metadata)


@pytest.mark.parametrize(
    ("make", "expected"),
    [
        (lambda _: None, "expected an ONNX file, found no such file; lidcam fetch yolox-nano downloads one"),
        (folder, "expected an ONNX file, found a folder"),
        (lambda path: path.write_text("this is no network\n"), "expected an ONNX file that onnxruntime can load"),
        (Path.touch, "expected an ONNX file that onnxruntime can load"),
        (
            lambda path: path.write_text("version https://git-lfs.github.com/spec/v1\noid"),
            "fetch it with `git lfs pull`",
        ),
        (cut, "expected an ONNX file that onnxruntime can load"),
        (network(raw_rows()[:, :25]), "20 classes, and its file has no names for them: set detect2d.names"),
        (network(raw_rows()[:-1]), "found output0 (1, 125, 85) for 96 x 64 px"),
        (network(raw_rows().T), "the network has 81 classes"),
        (network(raw_rows(), channel_weights=[1.0]), "found images (1, 1, 64, 96)"),
        (network(raw_rows(), size_px=(60, 96)), "found output0 (1, 126, 85) for 96 x 60 px"),
        (network(raw_rows(), outputs=2), "output1 (1, 126, 85)"),
        (network(raw_rows(), kind="float64"), "tensor(double)"),
        (for_task("segment"), "expected a network for detection, found one for the task 'segment'"),
        (for_task("x" * 5000), "expected a network for detection, found one for the task 'xxx"),
    ],
)
def test_other_files_are_refused_in_one_line(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], make: Callable[[Path], object], expected: str
) -> None:
    path = tmp_path / "m.onnx"
    make(path)
    with pytest.raises(ModelError) as caught:
        detector(path)
    message = str(caught.value)
    assert expected in message
    assert str(path) in message
    assert "\n" not in message
    assert len(message) < 600
    assert capfd.readouterr() == ("", ""), "the reason is raised, not printed"


def test_what_a_network_is_taken_for_is_logged(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO)
    path = write_yolox(tmp_path / "m.onnx", raw_rows(), size_px=SIZE_PX)
    OnnxDetector2D(path, Detect2DConfig())
    assert "takes 96 x 64 px only: " in caplog.messages[-2]
    assert caplog.messages[-1] == f"{path}: yolox, 80 classes, images of 96 x 64 px"


def test_a_checkpoint_of_pytorch_names_the_export(tmp_path: Path) -> None:
    (tmp_path / "yolov8n.pt").write_bytes(b"PK\x03\x04")
    with pytest.raises(
        ModelError, match=r"found a PyTorch checkpoint; export it first: .*model=yolov8n\.pt format=onnx$"
    ):
        detector(tmp_path / "yolov8n.pt")
