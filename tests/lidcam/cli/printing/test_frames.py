"""What is printed of a frame."""

import io
from dataclasses import replace

import numpy as np
from frames import CONFIG, frame, tracks_of
from rich.console import Console

from lidcam.cli.printing.console import print_detections, print_matches
from lidcam.pipeline.core.detections import Fused, Matches, Source
from lidcam.pipeline.core.frame import FrameResult

BOTH, CAMERA, LIDAR, PREDICTED = Source.BOTH, Source.CAMERA, Source.LIDAR, Source.PREDICTED


def printed(result: FrameResult) -> str:
    out = Console(file=io.StringIO(), width=200)
    print_detections(out, result, CONFIG)
    print_matches(out, result, CONFIG)
    assert isinstance(out.file, io.StringIO)
    return out.file.getvalue()


def test_every_source_is_printed() -> None:
    text = printed(frame(sources=[LIDAR, BOTH, CAMERA]))
    assert [line.strip() for line in text.splitlines() if "score" not in line][:3] == [
        "frame 0  stamp 1700000000123456789 ns  2 lidar detections",
        "1 placed by the cameras alone",
        "3 fused objects",
    ]
    assert "+- 2.24 m" in text  # the root of the variances along x and y, 4 and 1
    for remark in ("lidar, of row 0, 2 cam", "both, of row 1, 1 cam", "camera, of row 2, 0 cam"):
        assert remark in text


def test_what_is_not_reported_is_no_object() -> None:
    result = frame(sources=[LIDAR, BOTH, CAMERA])
    proposed = replace(result.hypotheses, lidar_count=1, matches=_matched_last(result))
    middle = np.array([1])
    fused = Fused(result.fused.objects.select(middle), result.fused.matched[middle], middle)
    lines = printed(replace(result, hypotheses=proposed, fused=fused)).splitlines()
    assert "  left: 2D box 1 (pedestrian) is 3D box 2 (not reported), IoU 0.50" in lines
    assert lines[-3:] == [
        "  object 0: proposed by 2D boxes, with points of the lidars",
        "  3D box 2 (not reported): proposed by 2D boxes, placed by the cameras alone",
        "  seen by the lidars alone: 3D box 0 (not reported)",
    ]


def test_tracks_are_printed_with_their_objects() -> None:
    result = frame(
        sources=[LIDAR, LIDAR, PREDICTED], tracks=tracks_of([12, 0, 7], [[3.0, 4.0], [0.0, 0.0], [0.0, 0.5]])
    )
    text = printed(result)
    for remark in (
        "  track 12, 5.0 m/s, 1.2 s old, lidar, of row 0, 2 cam\n",
        "  lidar, of row 1, 1 cam\n",
        "  track 7, 0.5 m/s, 1.2 s old, predicted\n",
    ):
        assert remark in text
    assert "  left: 2D box 0 (car) is object 0 (track 12), IoU 0.62\n" in text
    assert text.splitlines()[-2:] == [
        "  seen by the lidars alone: object 1",
        "  not detected, predicted by their tracks: object 2 (track 7)",
    ]


def _matched_last(result: FrameResult) -> dict[str, Matches]:
    pairs = {"left": np.array([[2, 1]]), "right": np.zeros((0, 2), np.int64)}
    return {
        name: replace(one, pairs=pairs[name], iou=np.full(len(pairs[name]), 0.5, np.float32))
        for name, one in result.matches.items()
    }
