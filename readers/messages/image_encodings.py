"""Converts pixels from the encodings of sensor_msgs/image_encodings.hpp (ROS 1 Noetic to ROS 2 Lyrical) to 8-bit RGB.

| encoding | taken as |
| --- | --- |
| rgb8 rgba8 bgr8 bgra8, and the same with 16 | colour; alpha is ignored |
| mono8 mono16 8UC1 16UC1 | grey |
| 8UC3 8UC4 16UC3 16UC4 | BGR and BGRA, OpenCV's order |
| bayer_rggb8 ... bayer_grbg16 | mosaic, named by the first row's two pixels and the second row's; bilinear |
| yuv422 = uyvy, yuv422_yuy2 = yuyv | two pixels in four bytes, ITU-R BT.601, limited range |
| nv12 nv21 nv24 | plane of Y, then of U and V in turn (nv21: V and U), ITU-R BT.601, limited range |

Of 16 bits the upper eight are kept (`value >> 8`), so images of 12-bit sensors that do not shift their values up are
dark. Signed, float and two-channel encodings hold measurements, not images. OpenCV is imported where pixels are
converted: most runs copy images as they are.
"""

from typing import NamedTuple

import numpy as np

from lidcam.pipeline.core.arrays import U8
from lidcam.pipeline.core.errors import MessageError
from lidcam.pipeline.core.settings.recording import RecordingLimits


class PackedEncoding(NamedTuple):
    """An encoding with all values of a pixel side by side."""

    channels: int  # Values per pixel
    depth_bytes: int  # Bytes per value, 1 or 2
    conversion: str | None  # OpenCV's name for the conversion to RGB; None for RGB itself
    mosaic: bool = False  # Whether each pixel has only one colour
    pixels_per_group: int = 1  # Pixels that share values; the width is a multiple of it


def _packed_encodings() -> dict[str, PackedEncoding]:
    colours = {
        "rgb": (3, None),
        "rgba": (4, "COLOR_RGBA2RGB"),
        "bgr": (3, "COLOR_BGR2RGB"),
        "bgra": (4, "COLOR_BGRA2RGB"),
        "mono": (1, "COLOR_GRAY2RGB"),
    }
    matrices = {1: "COLOR_GRAY2RGB", 3: "COLOR_BGR2RGB", 4: "COLOR_BGRA2RGB"}
    # These names follow ROS; OpenCV's older ones (BayerBG for RGGB) count from the second pixel of the second row.
    mosaics = {
        "rggb": "COLOR_BayerRGGB2RGB",
        "bggr": "COLOR_BayerBGGR2RGB",
        "gbrg": "COLOR_BayerGBRG2RGB",
        "grbg": "COLOR_BayerGRBG2RGB",
    }
    encodings = {}
    for bits in (8, 16):
        depth = bits // 8
        for name, (channels, code) in colours.items():
            encodings[f"{name}{bits}"] = PackedEncoding(channels, depth, code)
        for channels, code in matrices.items():
            encodings[f"{bits}uc{channels}"] = PackedEncoding(channels, depth, code)
        for name, code in mosaics.items():
            encodings[f"bayer_{name}{bits}"] = PackedEncoding(1, depth, code, mosaic=True)
    for name in ("yuv422", "uyvy"):
        encodings[name] = PackedEncoding(2, 1, "COLOR_YUV2RGB_UYVY", pixels_per_group=2)
    for name in ("yuv422_yuy2", "yuyv"):
        encodings[name] = PackedEncoding(2, 1, "COLOR_YUV2RGB_YUY2", pixels_per_group=2)
    return encodings


PACKED = _packed_encodings()
"""Encodings by name in lower case."""

PLANAR = {"nv12": "COLOR_YUV2RGB_NV12", "nv21": "COLOR_YUV2RGB_NV21", "nv24": None}
"""OpenCV's name for the conversion, by name in lower case; it has none for nv24."""

# ITU-R BT.601 with Y in 16..235 and U, V in 16..240, the numbers that OpenCV uses for the other YUV encodings.
_RGB_FROM_YUV = np.array([[1.164, 0.0, 1.596], [1.164, -0.391, -0.813], [1.164, 2.018, 0.0]])
_RGB_FROM_YUV_SHIFTED = np.hstack([_RGB_FROM_YUV, -_RGB_FROM_YUV @ [[16.0], [128.0], [128.0]]])


def packed_to_rgb(pixels: U8, encoding: PackedEncoding) -> U8:
    """Pixels (H, W, channels), the upper byte of each value, as RGB (H, W, 3); contiguous RGB is not copied."""
    if encoding.conversion is None:
        return np.ascontiguousarray(pixels)
    return _convert(pixels[..., 0] if encoding.channels == 1 else pixels, encoding.conversion)


def check_pixels(width: int, height: int, limits: RecordingLimits, topic: str, others: int = 0) -> None:
    """Refuse an image of more pixels than `limits` allow, by itself or with the `others` of its frame.

    Raises:
        MessageError: it has more.
    """
    if width * height > limits.max_image_mpx * 1e6:
        raise MessageError(
            f"{topic}: an image of {width} x {height} px, expected at most {limits.max_image_mpx:g} million pixels: "
            "raise limit_scale"
        )
    if others + width * height > limits.max_frame_mpx * 1e6:
        raise MessageError(
            f"{topic}: an image of {width} x {height} px, and {others} in other images of the frame, expected at most "
            f"{limits.max_frame_mpx:g} million pixels in all: raise limit_scale"
        )


def planar_rows(encoding: str, height: int) -> int:
    """Rows of `step` bytes in all planes of an image."""
    return height * 3 if encoding == "nv24" else height * 3 // 2


def planar_to_rgb(data: U8, encoding: str, *, height: int, width: int, step: int) -> U8:
    """Planes in rows of `step` bytes as RGB (H, W, 3); nv12 and nv21 have even width and height."""
    conversion = PLANAR[encoding]
    if conversion is not None:
        return _convert(np.ndarray((planar_rows(encoding, height), width), np.uint8, data, 0, (step, 1)), conversion)
    import cv2

    luma: U8 = np.ndarray((height, width, 1), np.uint8, data, 0, (step, 1, 1))
    chroma: U8 = np.ndarray((height, width, 2), np.uint8, data, height * step, (2 * step, 2, 1))
    return np.asarray(cv2.transform(np.concatenate([luma, chroma], -1), _RGB_FROM_YUV_SHIFTED), np.uint8)


def _convert(pixels: U8, conversion: str) -> U8:
    import cv2

    return np.asarray(cv2.cvtColor(pixels, getattr(cv2, conversion)), np.uint8)
