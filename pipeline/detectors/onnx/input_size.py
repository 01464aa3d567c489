"""Which size of its input a network is given for an image."""

from functools import lru_cache

__all__ = ["input_size"]


@lru_cache(maxsize=1024)
def input_size(width_px: int, height_px: int, *, most_px: int, stride_px: int) -> tuple[int, int]:
    """Width and height in pixels, multiples of the stride, that show the image largest.

    The image is scaled to fit, with its shape kept. Of all sizes of `most_px` pixels at most, this is the one with
    the largest scale, then the one with the fewest pixels, then the widest. An image is not enlarged. If the least
    size is beyond `most_px`, that is taken all the same.

    Args:
        width_px: Width of the image.
        height_px: Its height.
        most_px: Pixels of the input at most.
        stride_px: What width and height are multiples of.
    """
    cells = max(most_px // stride_px**2, 1)
    best, chosen = (-1.0, 0), (1, 1)
    full = -(-width_px // stride_px), -(-height_px // stride_px)
    for columns in range(min(cells, full[0]), 0, -1):
        # The rows that this width needs; more would stay empty, and of fewer the height decides.
        needed = -(-columns * height_px // width_px)
        rows = max(min(cells // columns, needed, full[1]), 1)
        scale = min(columns * stride_px / width_px, rows * stride_px / height_px, 1.0)
        if (scale, -columns * rows) > best:
            best, chosen = (scale, -columns * rows), (columns, rows)
    return chosen[0] * stride_px, chosen[1] * stride_px
