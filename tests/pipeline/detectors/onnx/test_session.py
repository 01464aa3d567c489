"""Networks that would run without end, fill the memory or read other files give one line; so do outputs of no use."""

from pathlib import Path
from random import Random

import numpy as np
import onnx_models
import pytest
from onnx_files import FLOAT, _node, _tensor, _value, write_model

from lidcam.pipeline.core.errors import ModelError
from lidcam.pipeline.core.settings.detect import Detect2DConfig
from lidcam.pipeline.detectors.onnx import session
from lidcam.pipeline.detectors.onnx.detector import OnnxDetector2D


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


def test_the_memory_of_a_network_is_bounded(tmp_path: Path) -> None:
    rows = onnx_models.ROWS
    nodes = [
        _node("ReduceMean", ["images"], "mean", axes=[1, 2, 3], keepdims=0),
        _node("ConstantOfShape", ["shape"], "huge"),  # 5 GiB
        _node("ReduceMean", ["huge"], "point", keepdims=0),
        _node("Add", ["mean", "point"], "sum"),
        _node("Unsqueeze", ["sum"], "column", axes=[1, 2]),
        _node("Add", ["column", "bias"], "output0"),
    ]
    constants = [_tensor("bias", np.zeros((1, rows, 85), np.float32), FLOAT)]
    constants.append(_tensor("shape", np.array([1 << 14, 1 << 14, 5], np.int64), 7))
    images, output = _value("images", (1, 3, *onnx_models.SIZE_PX), FLOAT), _value("output0", (1, rows, 85), FLOAT)
    said = said_of(write_model(tmp_path / "a.onnx", nodes, constants, [images], [output]))
    assert "the network fails on a batch of 1: " in said


@pytest.mark.parametrize("shape", [(1, 3, 1 << 15, 1 << 15), (4096, 3, 4096, 64), ("N", 3, (1 << 31) - 32, 64)])
def test_images_of_absurd_size(tmp_path: Path, shape: tuple[int | str, ...]) -> None:
    onnx_models._network(tmp_path / "a.onnx", [], _value("images", shape, FLOAT))
    assert "GiB, expected at most 0.5 GiB" in said_of(tmp_path / "a.onnx")


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_outputs_that_are_no_numbers(tmp_path: Path, value: float) -> None:
    bias = _tensor("bias", np.full((1, onnx_models.ROWS, 85), value, np.float32), FLOAT)
    onnx_models._network(tmp_path / "a.onnx", [], bias=bias)
    assert "found an output that is not finite" in said_of(tmp_path / "a.onnx")
