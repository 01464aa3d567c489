import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.detectors.onnx.input_size import input_size


@pytest.mark.parametrize(
    ("image", "most_px", "expected"),
    [
        ((640, 480), 640 * 480, (640, 480)),
        ((1242, 375), 640 * 480, (960, 320)),
        ((1242, 375), 640 * 224, (640, 224)),
        ((1600, 900), 640 * 480, (736, 416)),
        ((320, 240), 640 * 480, (320, 256)),
        ((1, 1), 640 * 480, (32, 32)),
        ((1242, 375), 1, (32, 32)),
        ((30_000, 10), 640 * 480, (9600, 32)),
        ((10, 400_000), 640 * 480, (32, 9600)),
    ],
)
def test_known_images(image: tuple[int, int], most_px: int, expected: tuple[int, int]) -> None:
    assert input_size(*image, most_px=most_px, stride_px=32) == expected


@given(st.integers(1, 2000), st.integers(1, 2000), st.integers(1, 60 * 32**2), st.sampled_from([32, 64]))
def test_is_the_best_of_all_sizes(width: int, height: int, most_px: int, stride: int) -> None:
    cells = max(most_px // stride**2, 1)
    sizes = [(columns, rows) for columns in range(1, cells + 1) for rows in range(1, cells // columns + 1)]

    def worth(size: tuple[int, int]) -> tuple[float, int, int]:
        scale = min(size[0] * stride / width, size[1] * stride / height, 1.0)
        return scale, -size[0] * size[1], size[0]

    columns, rows = max(sizes, key=worth)
    assert input_size(width, height, most_px=most_px, stride_px=stride) == (columns * stride, rows * stride)
