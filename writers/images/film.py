"""Writes the images of a run as a film (MP4, H.264), at the pace of the recording. Imports PyAV (extra `video`).

The writer of OpenCV's wheel has no H.264, and its images are all shown for the same time.
"""

import json
from contextlib import ExitStack
from fractions import Fraction
from typing import Any

import av
from av.video.reformatter import ColorRange, Colorspace

from lidcam.pipeline.core.arrays import U8
from lidcam.pipeline.core.frame import FrameResult
from lidcam.pipeline.core.messages import Drop
from lidcam.writers.base import ResultWriter
from lidcam.writers.images.scene import SIZE_PX, Scenes
from lidcam.writers.outputs.errors import output_errors
from lidcam.writers.outputs.marks import FILM
from lidcam.writers.outputs.transaction import OutputFile
from lidcam.writers.provenance import Provenance

TICKS_PER_S = 1000
TICK_S = Fraction(1, TICKS_PER_S)
NOMINAL_HZ = Fraction(10)
"""The rate that x264 is told; each image has its own time."""

MIN_NS, MAX_NS = 1_000_000, 2_000_000_000
"""A frame is shown until the next one; where that comes later than this, or time jumps back, for the longer time."""

USUAL_NS = 100_000_000
"""How long the last frame is shown."""

KEY_FRAMES = 30
"""Images from one at which a player can begin to the next."""

THREADS = 2
"""Always as many: what x264 writes depends on it."""

OPTIONS = {"preset": "veryfast", "crf": "24"}
BT709 = 1
"""Number of the colours of high definition in H.264."""


class FilmWriter(ResultWriter):
    """Writes an `.mp4`.

    Its tag `comment` has, as JSON, where the result comes from (`Provenance.metadata`).
    """

    name = "video"

    def __init__(self, output: OutputFile, scenes: Scenes, provenance: Provenance) -> None:
        self.path, self._output, self._scenes = output.path, output, scenes
        self._comment = f"{FILM} {json.dumps(provenance.metadata())}"
        self._waiting: U8 | None = None
        self._last_ns = self._shown_ns = 0

    def _open(self, resources: ExitStack) -> None:
        options = {"fflags": "+bitexact", "movflags": "+faststart"}
        self._file: Any = resources.enter_context(av.open(self._output.part, "w", format="mp4", options=options))
        self._file.metadata["comment"] = self._comment
        self._stream: Any = self._file.add_stream("libx264", options=OPTIONS)
        coder = self._stream.codec_context
        coder.width, coder.height = SIZE_PX
        coder.pix_fmt, coder.gop_size, coder.thread_count = "yuv420p", KEY_FRAMES, THREADS
        coder.time_base, coder.framerate = TICK_S, NOMINAL_HZ
        coder.colorspace = coder.color_primaries = coder.color_trc = BT709
        coder.color_range = ColorRange.MPEG

    def _finish(self) -> None:
        self._encode(USUAL_NS)
        self._file.mux(self._stream.encode(None))

    def write(self, result: FrameResult) -> tuple[Drop, ...]:
        """Add one frame; returns images that cannot be decoded."""
        stamp_ns = result.bundle.stamp_ns
        if self._waiting is not None:
            step_ns = stamp_ns - self._last_ns
            self._encode(step_ns if MIN_NS <= step_ns <= MAX_NS else MAX_NS)
        image, drops = self._scenes.all_cameras(self._scenes.add_frame(result))
        self._waiting, self._last_ns = image, stamp_ns
        return drops

    def _encode(self, shown_ns: int) -> None:
        """Write the image that waits: for how long it is shown is known when the next one comes."""
        if self._waiting is None:
            return
        frame = av.VideoFrame.from_ndarray(self._waiting, format="rgb24")
        frame = frame.reformat(format="yuv420p", dst_colorspace=Colorspace.ITU709)
        first, last = (round(ns * TICKS_PER_S / 1e9) for ns in (self._shown_ns, self._shown_ns + shown_ns))
        frame.pts, frame.duration, frame.time_base = first, last - first, TICK_S
        self._shown_ns += shown_ns
        with output_errors(self.path):
            self._file.mux(self._stream.encode(frame))
