from pathlib import Path

import numpy as np
import pytest
from onnx_files import write_yolox

from pipeline.core.errors import ModelError
from pipeline.core.settings.config import Config
from pipeline.core.settings.detect import Detect2DConfig
from pipeline.detectors.onnx.detector import OnnxDetector2D
from pipeline.detectors.onnx.providers import check_runs_on, providers_for

CPU, CUDA = "CPUExecutionProvider", "CUDAExecutionProvider"


def test_the_processor_comes_last_and_alone_by_default() -> None:
    assert providers_for("cpu", [CUDA, CPU]) == [CPU]
    assert providers_for("cuda", [CUDA, CPU]) == [CUDA, CPU]


@pytest.mark.parametrize(
    ("provider", "remedy"), [("cuda", "; pip install onnxruntime-gpu in place of onnxruntime"), ("coreml", "")]
)
def test_what_the_installed_onnxruntime_lacks(tmp_path: Path, provider: str, remedy: str) -> None:
    path = write_yolox(tmp_path / "m.onnx", np.zeros((84, 85), np.float32), size_px=(64, 64))
    with pytest.raises(ModelError, match=rf"detect2d\.provider: expected cpu, .* found {provider}{remedy}$"):
        OnnxDetector2D(path, Config(detect2d=Detect2DConfig.model_validate({"provider": provider})))


def test_a_fall_back_is_no_accelerator() -> None:
    check_runs_on("cuda", [CUDA, CPU])
    with pytest.raises(ModelError, match="cuda cannot be used on this machine"):
        check_runs_on("cuda", [CPU])
