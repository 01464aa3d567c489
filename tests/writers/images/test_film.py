"""Films, decoded again by FFmpeg."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest
from frames import CONFIG, PROVENANCE, RIG, START_NS, frame
from video import psnr_db

from lidcam.pipeline.core.arrays import U8
from lidcam.pipeline.core.frame import FrameResult
from lidcam.readers.messages.image import decode_any_image
from lidcam.writers.images.film import FilmWriter
from lidcam.writers.images.scene import SIZE_PX, Scenes
from lidcam.writers.outputs.transaction import OutputFile

FRAME = frame()


def at(second: float) -> FrameResult:
    return replace(FRAME, bundle=replace(FRAME.bundle, stamp_ns=START_NS + round(second * 1e9)))


def film(path: Path, seconds: Sequence[float]) -> tuple[list[float], list[U8], Any]:
    """When the images of a film are shown, the images, and its tags."""
    with FilmWriter(OutputFile(path, path), Scenes(RIG, CONFIG, decode_any_image), PROVENANCE) as writer:
        drops = [drop.topic for second in seconds for drop in writer.write(at(second))]
    assert drops == ["/right/image"] * len(seconds)
    with av.open(path) as file:
        stream: Any = file.streams.video[0]
        shown = [(float(one.time), one.to_ndarray(format="rgb24")) for one in file.decode(stream)]
        assert (stream.codec_context.name, stream.codec_context.pix_fmt) == ("h264", "yuv420p")
        times = [round(time, 3) for time, _ in shown] + [round(float(stream.duration * stream.time_base), 3)]
        return times, [np.asarray(image, np.uint8) for _, image in shown], dict(file.metadata)


@pytest.mark.parametrize(
    ("seconds", "shown"),
    [
        ([0.0], [0.0, 0.1]),
        ([0.0, 0.25, 0.3], [0.0, 0.25, 0.3, 0.4]),
        ([5.0, 600.0, 0.0], [0.0, 2.0, 4.0, 4.1]),  # a gap, and time that jumps back
    ],
)
def test_the_pace_is_that_of_the_recording(tmp_path: Path, seconds: list[float], shown: list[float]) -> None:
    times, images, tags = film(tmp_path / "a.mp4", seconds)
    assert times == shown
    scenes = Scenes(RIG, CONFIG, decode_any_image)
    expected, _ = scenes.all_cameras(scenes.add_frame(at(seconds[0])))
    assert images[0].shape == (SIZE_PX[1], SIZE_PX[0], 3)
    assert psnr_db(images[0], expected) > 25
    assert tags["comment"].startswith('lidcam.film {"version": "1.2.3"')
