"""Lines, areas and texts on an image, in the same manner in all images."""

from collections.abc import Iterable, Sequence
from functools import cache
from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from lidcam.pipeline.core.arrays import F64, U8
from lidcam.pipeline.core.text import visible

Color = tuple[int, int, int]
"""Red, green, blue from 0 to 255."""

BACKGROUND: Color = (20, 22, 26)
TEXT: Color = (240, 242, 245)
FAINT_TEXT: Color = (150, 156, 166)

_PLATE_OPACITY = 0.62
_WEIGHT = 500
_STROKES = cv2.FONT_HERSHEY_SIMPLEX
_BITS = 4
"""Bits of the fraction of a pixel: OpenCV draws at fixed-point places."""

_REACH_PX = 1e6
"""Places farther away are drawn at this distance: OpenCV's numbers end somewhere."""


class Label(NamedTuple):
    """A text beside something: left and bottom edge in pixels, one line, and which of two makes room."""

    x: float
    y: float
    text: str
    color: Color
    importance: float


class Canvas:
    """An image that is drawn on. Places are pixels; (0, 0) is the top left corner of the top left pixel.

    Attributes:
        pixels: (H, W, 3) uint8, red, green, blue.
        size_px: Width and height.
    """

    def __init__(self, pixels: U8, letter_px: int) -> None:
        """Take over an image, which is changed; `letter_px` is the height of the font."""
        self.pixels, self._letter_px = pixels, letter_px
        self.size_px: tuple[int, int] = (pixels.shape[1], pixels.shape[0])

    @classmethod
    def blank(cls, width_px: int, height_px: int, letter_px: int) -> "Canvas":
        """A dark one."""
        row = np.tile(np.array(BACKGROUND, np.uint8), width_px)  # numpy fills slowly three by three
        return cls(np.tile(row, (height_px, 1)).reshape(height_px, width_px, 3), letter_px)

    def lines(
        self, lines: Iterable[npt.ArrayLike], color: Color, width_px: int = 1, *, closed: bool = False, shade: int = 0
    ) -> None:
        """Lines, each through points (K, 2); with this many dark pixels beside, to be seen on any image."""
        fixed = [_fixed(line)[:, None] for line in lines]
        for one, width in [((0, 0, 0), width_px + 2 * shade)] * bool(shade) + [(color, width_px)]:
            cv2.polylines(self.pixels, fixed, closed, one, width, cv2.LINE_AA, _BITS)

    def areas(self, polygons: Iterable[F64], colors: Iterable[Color], opacity: float) -> None:
        """Convex polygons (K, 2) that let through what is below them."""
        filled = self.pixels.copy()
        for corners, color in zip(polygons, colors, strict=True):
            cv2.fillConvexPoly(filled, _fixed(corners), color, cv2.LINE_AA, _BITS)
        cv2.addWeighted(filled, opacity, self.pixels, 1 - opacity, 0.0, self.pixels)

    def arrow(self, start: F64, end: F64, color: Color) -> None:
        """An arrow between points (2,)."""
        head = 10 / max(float(np.linalg.norm(end - start)), 20.0)
        first, last = (_fixed(point).tolist() for point in (start, end))
        cv2.arrowedLine(self.pixels, first, last, color, 2, cv2.LINE_AA, _BITS, head)

    def dots(self, places: npt.ArrayLike, color: Color, radius_px: float) -> None:
        """Filled circles at places (N, 2)."""
        for place in _fixed(places).tolist():
            cv2.circle(self.pixels, place, round(radius_px * 2**_BITS), color, -1, cv2.LINE_AA, _BITS)

    def text(self, x: float, y: float, text: str, color: Color = TEXT, *, share: float = 0.0) -> None:
        """A text whose line ends at the bottom at `y`, with this share of its width left of `x`."""
        x -= share * self.text_width_px(text)
        at = (round(x), round(y - 0.2 * self._letter_px))
        if font := _font():
            cv2.putText(self.pixels, visible(text), at, color, font, self._letter_px, _WEIGHT)
        else:
            cv2.putText(self.pixels, _ascii(text), at, _STROKES, self._strokes_scale, color, 1, cv2.LINE_AA)

    def text_width_px(self, text: str) -> int:
        """Width of a text."""
        if font := _font():
            image_px = (1 << 14, 1 << 10)
            return int(cv2.getTextSize(image_px, visible(text), (0, 0), font, self._letter_px, _WEIGHT)[2])
        return int(cv2.getTextSize(_ascii(text), _STROKES, self._strokes_scale, 1)[0][0])

    @property
    def _strokes_scale(self) -> float:
        return cv2.getFontScaleFromHeight(_STROKES, round(0.7 * self._letter_px))

    def labels(self, labels: Sequence[Label]) -> None:
        """Texts on dark plates. None covers another: it moves up or down a line, or is left out."""
        height = round(1.25 * self._letter_px)
        taken = np.zeros((0, 4))
        for label in sorted(labels, key=lambda one: -one.importance):
            width = self.text_width_px(label.text) + 6
            x = min(max(label.x, 0.0), max(self.size_px[0] - width, 0))
            for lines in (0, 1, -1, 2, -2):
                y = min(max(label.y + lines * height, height), self.size_px[1])
                plate = np.array([x, y - height, x + width, y])
                if not ((plate[:2] < taken[:, 2:]) & (plate[2:] > taken[:, :2])).all(1).any():
                    taken = np.concatenate([taken, plate[None]])
                    left, top, right, bottom = (round(edge) for edge in plate.tolist())
                    part = self.pixels[top:bottom, left:right]
                    part[:] = (part * (1 - _PLATE_OPACITY)).astype(np.uint8)
                    self.text(left + 3, bottom, label.text, label.color)
                    break


@cache
def _font() -> "cv2.FontFace | None":
    """A font that is part of OpenCV 5 and has the letters of many scripts; it takes a while to load."""
    return cv2.FontFace("uni") if hasattr(cv2, "FontFace") else None


def _ascii(text: str) -> str:
    """A text as far as OpenCV 4 has letters: those of ASCII."""
    return visible(text).encode("ascii", "replace").decode()


def _fixed(points: npt.ArrayLike) -> npt.NDArray[np.int32]:
    """Points (..., 2) as OpenCV's fixed-point numbers, whose (0, 0) is the middle of a pixel."""
    places = np.clip(np.asarray(points, np.float64), -_REACH_PX, _REACH_PX) - 0.5
    return np.asarray(np.round(places * 2**_BITS), np.int32)
