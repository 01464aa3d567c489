"""Images and films of runs, by the command and from Python."""

from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
import pytest
from builders import write_mcap
from command import Lidcam, called
from helpers import CLUSTERS, SANDBOX
from small_drive import small_drive
from video import psnr_db

import lidcam as library
from lidcam.pipeline.core.arrays import U8

PART = ("--config", "sandbox", "--duration", "0.3", "--set", CLUSTERS)
SAME: dict[str, Any] = {"config": "sandbox", "duration_s": 0.3, "settings": [CLUSTERS]}
"""The same in Python."""

CAMERA = "cam11"


def images_of(film: Path) -> list[U8]:
    with av.open(film) as file:
        return [np.asarray(one.to_ndarray(format="rgb24"), np.uint8) for one in file.decode(video=0)]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("made")
    outputs = ("out.mcap", "--video", "out.mp4", "--save-matches", "images")
    done = called(folder, SANDBOX, *outputs, *PART, "--workers", 1, program="lidcam-process")
    assert done.code == 0, done.err
    assert "lidcam view out.mcap (or .mp4)" in done.out
    return folder


def test_frames_draw_the_same(made: Path) -> None:
    frames = [*library.iter_frames(SANDBOX, workers=1, **SAME)]
    shown = images_of(made / "out.mp4")
    assert len(frames) == len(shown) > 1
    for number, (frame, image) in enumerate(zip(frames, shown, strict=True)):
        assert psnr_db(image, frame.draw()) > 28
        read_back = cv2.imread(str(made / "images" / f"frame_{number:06d}_{CAMERA}.jpg"))
        assert read_back is not None
        assert psnr_db(np.asarray(read_back[..., ::-1], np.uint8), frame.draw(CAMERA)) > 30
    assert len([*(made / "images").iterdir()]) == 8 * len(frames)
    with pytest.raises(library.ConfigError, match="camera: expected one of cam11, "):
        frames[0].draw("front")


def test_a_later_run_replaces_them_with_the_same_bytes(made: Path) -> None:
    def content() -> dict[str, bytes]:
        return {path.name: path.read_bytes() for path in made.rglob("*") if path.suffix in {".mp4", ".jpg"}}

    before = content()
    library.process(SANDBOX, made / "out.mp4", save_matches=made / "images", **SAME)
    assert content() == before


def test_a_recording_without_cameras(tmp_path: Path, lidcam: Lidcam) -> None:
    write_mcap(tmp_path / "rec.mcap", small_drive("cdr", frames=3, motion="none", kinds=()))
    done = lidcam("process", tmp_path / "rec.mcap", tmp_path / "out.mcap", "--video", tmp_path / "out.mp4")
    assert done.code == 0, done.err
    assert len(images_of(tmp_path / "out.mp4")) == 3
    refused = lidcam("process", tmp_path / "rec.mcap", tmp_path / "other.mcap", "--save-matches", tmp_path / "images")
    assert "images: images of matches need cameras" in refused.error_line
    assert not (tmp_path / "other.mcap").exists()
