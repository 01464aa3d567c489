import numpy as np
import pytest

from pipeline.core.errors import ModelError
from pipeline.detectors.onnx.inputs import Value, read_inputs

IMAGES: Value = ("images", [1, 3, 64, 96], "tensor(float)")
SIZES: Value = ("orig_target_sizes", ["N", 2], "tensor(int64)")


def test_images_alone() -> None:
    inputs = read_inputs([IMAGES])
    assert (inputs.batch, inputs.height_px, inputs.width_px, inputs.sizes) == (1, 64, 96, None)
    batch = np.zeros((1, 3, 64, 96), np.float32)
    assert {name: array is batch for name, array in inputs.feed(batch).items()} == {"images": True}


def test_images_with_their_sizes_in_half_precision() -> None:
    inputs = read_inputs([SIZES, ("x", ["N", 3, "h", -1], "tensor(float16)")])
    assert (inputs.batch, inputs.height_px, inputs.width_px) == (None, None, None)
    fed = inputs.feed(np.zeros((2, 3, 64, 96), np.float32))
    assert fed["x"].dtype == np.float16
    assert fed["orig_target_sizes"].tolist() == [[96, 64], [96, 64]]
    assert fed["orig_target_sizes"].dtype == np.int64


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
