"""Networks that would run without end, fill the memory or read other files give one line; so do outputs of no use."""

from collections.abc import Callable
from pathlib import Path
from random import Random

import numpy as np
import onnx_models
import pytest
from onnx_files import FLOAT, _bytes, _int, _ints, _node, _tensor, _value, _varint_field

from lidcam.pipeline.core.errors import ModelError
from lidcam.pipeline.core.settings.detect import Detect2DConfig
from lidcam.pipeline.detectors.onnx import session
from lidcam.pipeline.detectors.onnx.detector import OnnxDetector2D
from lidcam.pipeline.detectors.onnx.session import check_runs_on, providers_for

CPU, CUDA = "CPUExecutionProvider", "CUDAExecutionProvider"


def load(path: Path, **settings: object) -> OnnxDetector2D:
    return OnnxDetector2D(path, Detect2DConfig.model_validate(settings))


def said_of(path: Path, **settings: object) -> str:
    with pytest.raises(ModelError) as caught:
        load(path, **settings)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_a_loop_without_end_is_ended(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(session, "MAX_SECONDS", 0.2)
    onnx_models._loop(tmp_path / "a.onnx", Random(0))
    assert "it did not end within 0.2 s" in said_of(tmp_path / "a.onnx")


def test_what_a_network_may_take_is_bounded(tmp_path: Path) -> None:
    shape = _tensor("", np.array([1 << 14, 1 << 14, 5], np.int64), 7)
    mean = _node("ReduceMean", ["images"], "mean", _ints("axes", [1, 2, 3]), _int("keepdims", 0))
    nodes = [
        _node("Constant", [], "shape", _bytes(1, b"value") + _bytes(5, shape) + _varint_field(20, 4)),
        _node("ConstantOfShape", ["shape"], "huge"),  # 5 GiB
        _node("ReduceMean", ["huge"], "point", _int("keepdims", 0)),
        mean,
        _node("Add", ["mean", "point"], "sum"),
        _node("Unsqueeze", ["sum"], "column", _ints("axes", [1, 2])),
        _node("Add", ["column", "bias"], "output0"),
    ]
    graph = b"".join(_bytes(1, node) for node in nodes) + _bytes(2, b"g")
    graph += _bytes(5, _tensor("bias", np.zeros((1, onnx_models.ROWS, 85), np.float32), FLOAT))
    graph += _bytes(11, _value("images", (1, 3, *onnx_models.SIZE_PX), FLOAT))
    graph += _bytes(12, _value("output0", (1, onnx_models.ROWS, 85), FLOAT))
    path = tmp_path / "a.onnx"
    path.write_bytes(_varint_field(1, 6) + _bytes(8, _varint_field(2, 11)) + _bytes(7, graph))
    assert "the network fails on a batch of 1: " in said_of(path)


@pytest.mark.parametrize("shape", [(1, 3, 1 << 15, 1 << 15), (4096, 3, 4096, 64), ("N", 3, (1 << 31) - 32, 64)])
def test_images_of_absurd_size(tmp_path: Path, shape: tuple[int | str, ...]) -> None:
    onnx_models._network(tmp_path / "a.onnx", [], _value("images", shape, FLOAT))
    assert "GiB, expected at most 0.5 GiB" in said_of(tmp_path / "a.onnx")


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_outputs_that_are_no_numbers(tmp_path: Path, value: float) -> None:
    bias = _tensor("bias", np.full((1, onnx_models.ROWS, 85), value, np.float32), FLOAT)
    onnx_models._network(tmp_path / "a.onnx", [], bias=bias)
    assert "found an output that is not finite" in said_of(tmp_path / "a.onnx")


@pytest.mark.parametrize("make", [onnx_models._cut, onnx_models._custom])
def test_damaged_files(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], make: Callable[[Path, Random], object]
) -> None:
    for seed in range(3):
        make(tmp_path / "a.onnx", Random(seed))
        said_of(tmp_path / "a.onnx")
    assert capfd.readouterr() == ("", "")


def test_the_processor_comes_last_and_alone_by_default() -> None:
    assert providers_for("cpu", [CUDA, CPU]) == [CPU]
    assert providers_for("cuda", [CUDA, CPU]) == [CUDA, CPU]


@pytest.mark.parametrize(
    ("provider", "remedy"), [("cuda", "; pip install onnxruntime-gpu in place of onnxruntime"), ("coreml", "")]
)
def test_what_the_installed_onnxruntime_lacks(tmp_path: Path, provider: str, remedy: str) -> None:
    onnx_models._network(tmp_path / "a.onnx", [])
    said = said_of(tmp_path / "a.onnx", provider=provider)
    assert "detect2d.provider: expected cpu, " in said
    assert said.endswith(f"found {provider}{remedy}")


def test_a_fall_back_is_no_accelerator() -> None:
    check_runs_on("cuda", [CUDA, CPU])
    with pytest.raises(ModelError, match="cuda cannot be used on this machine"):
        check_runs_on("cuda", [CPU])
