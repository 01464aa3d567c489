"""Networks that would fill the memory give one line; so do outputs of no use."""

from pathlib import Path

import numpy as np
import pytest
from onnx_files import value, write_model, write_yolox

from lidcam.pipeline.core.errors import ModelError
from lidcam.pipeline.core.settings.detect import Detect2DConfig
from lidcam.pipeline.detectors.onnx.detector import OnnxDetector2D

SIZE_PX, BIAS = (64, 64), np.zeros((84, 85), np.float32)


def said_of(path: Path, **settings: object) -> str:
    with pytest.raises(ModelError) as caught:
        OnnxDetector2D(path, Detect2DConfig.model_validate(settings))
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_the_memory_of_a_network_is_bounded(tmp_path: Path) -> None:
    text = f"""({value("images", (1, 3, *SIZE_PX))}) => ({value("output0", (1, *BIAS.shape))}) {{
        mean = ReduceMean <axes = [1, 2, 3], keepdims = 0> (images)
        huge = ConstantOfShape (shape) point = ReduceMean <keepdims = 0> (huge)
        sum = Add (mean, point) column = Unsqueeze <axes = [1, 2]> (sum) output0 = Add (column, bias)
    }}"""
    constants = {"bias": BIAS[None], "shape": np.array([1 << 14, 1 << 14, 5])}  # 5 GiB
    said = said_of(write_model(tmp_path / "a.onnx", text, constants))
    assert "the network fails on a batch of 1: " in said


@pytest.mark.parametrize(
    ("batch", "size_px"), [(1, (1 << 15, 1 << 15)), (4096, (4096, 64)), ("N", ((1 << 31) - 32, 64))]
)
def test_images_of_absurd_size(tmp_path: Path, batch: int | str, size_px: tuple[int, int]) -> None:
    write_yolox(tmp_path / "a.onnx", BIAS, size_px=size_px, batch=batch)
    assert "GiB, expected at most 0.5 GiB" in said_of(tmp_path / "a.onnx")


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_outputs_that_are_no_numbers(tmp_path: Path, value: float) -> None:
    write_yolox(tmp_path / "a.onnx", np.full_like(BIAS, value), size_px=SIZE_PX)
    assert "found an output that is not finite" in said_of(tmp_path / "a.onnx")
