import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lidcam.pipeline.core.errors import ModelError
from lidcam.pipeline.detectors.onnx.inputs import Value, input_size, read_inputs

IMAGES: Value = ("images", [1, 3, 64, 96], "tensor(float)")
SIZES: Value = ("orig_target_sizes", ["N", 2], "tensor(int64)")


def test_inputs_with_and_without_sizes() -> None:
    inputs, batch = read_inputs([IMAGES]), np.zeros((1, 3, 64, 96), np.float32)
    assert (inputs.batch, inputs.height_px, inputs.width_px, inputs.sizes) == (1, 64, 96, None)
    assert {name: array is batch for name, array in inputs.feed(batch).items()} == {"images": True}

    inputs = read_inputs([SIZES, ("x", ["N", 3, "h", -1], "tensor(float16)")])
    assert (inputs.batch, inputs.height_px, inputs.width_px) == (None, None, None)
    fed = inputs.feed(np.zeros((2, 3, 64, 96), np.float32))
    assert fed["x"].dtype == np.float16
    assert fed["orig_target_sizes"].dtype == np.int64
    assert fed["orig_target_sizes"].tolist() == [[96, 64], [96, 64]]


@pytest.mark.parametrize(
    "inputs",
    [
        [],
        [SIZES],
        [IMAGES, IMAGES],
        [IMAGES, SIZES, SIZES],
        [IMAGES, ("im_shape", [1, 2], "tensor(float)")],
        [IMAGES, ("sizes", [1, 4], "tensor(int64)")],
        [("images", [1, 64, 96, 3], "tensor(float)")],
        [("images", [1, 4, 64, 96], "tensor(float)")],
        [("images", [1, 3, 64, 96], "tensor(uint8)")],
        [("images", [1, 3, 64], "tensor(float)")],
    ],
)
def test_other_inputs(inputs: list[Value]) -> None:
    with pytest.raises(ModelError, match=r"expected one input \(N, 3, H, W\) of float32 or float16"):
        read_inputs(inputs)


@given(st.integers(1, 2000), st.integers(1, 2000), st.integers(1, 60 * 32**2), st.sampled_from([32, 64]))
def test_the_size_for_an_image_is_the_best_of_all(width: int, height: int, max_px: int, stride: int) -> None:
    cells = max(max_px // stride**2, 1)
    sizes = [(columns, rows) for columns in range(1, cells + 1) for rows in range(1, cells // columns + 1)]

    def worth(size: tuple[int, int]) -> tuple[float, int, int]:
        scale = min(size[0] * stride / width, size[1] * stride / height, 1.0)
        return scale, -size[0] * size[1], size[0]

    columns, rows = max(sizes, key=worth)
    assert input_size(width, height, max_px=max_px, stride_px=stride) == (columns * stride, rows * stride)
