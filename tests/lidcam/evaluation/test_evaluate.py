"""What makes figures doubtful is said with what to try."""

from typing import Any

import pytest

from lidcam.evaluation.evaluate import doubts

SOUND: dict[str, Any] = {
    "frames": 20,
    "frames_with_truth": 19,
    "truth_objects": {
        "evaluated": 40,
        "without_class": 0,
        "marked_as_ignored": 3,
        "outside": 0,
        "unseen": 2,
        "labels_without_class": {},
    },
    "fusion_gain": {"car": {"blocks": 2, "ap_bev_r40_50": {"value": 0.1, "takes_away": False}}},
    "sources": {"fused": {"all": {"truth": 40, "found": 38, "right": 37}}},
}
NONE_EVALUATED = SOUND["truth_objects"] | {"evaluated": 0}
LABELS = {"tram": 12, "animal": 30, "a": 1, "b": 1, "c": 1, "d": 1}
TAKES_AWAY = {"value": -0.1, "low": -0.15, "high": -0.05, "over": "lidar", "takes_away": True}
TAKEN = {"car": {"blocks": 2, "ap_bev_r40_50": TAKES_AWAY}}
SOURCE = {"all": {"truth": 40, "found": 38, "right": 37}}


def of_all(**figures: int) -> dict[str, Any]:
    return {"sources": {"fused": {"all": SOURCE["all"] | figures}}}


@pytest.mark.parametrize(
    ("changed", "told"),
    [
        ({}, []),
        (
            {"frames_with_truth": 0},
            [
                "truth: it covers the time of none of 20 frames; check that it is of the same recording, and that its "
                "stamps are of the same clock"
            ],
        ),
        (
            {"truth_offset_s": -0.5},
            [
                "truth: most objects that move are found where it has them about 0.50 s earlier; if its clock is "
                "another one: --set evaluate.truth_offset_ms=-500"
            ],
        ),
        (
            {"truth_objects": NONE_EVALUATED},
            [
                "truth: none of its objects is evaluated: 3 marked as ignored, 2 without a lidar point and without a "
                "pixel; look at the section evaluate of the settings"
            ],
        ),
        (
            {"truth_objects": SOUND["truth_objects"] | {"without_class": 46, "labels_without_class": LABELS}},
            [
                "truth: objects of no configured class are ignored: animal (30), tram (12), a (1), b (1), c (1) and 1 "
                "more; add the words to classes.N.labels if they mean one of the classes"
            ],
        ),
        (
            of_all(found=0, right=0),
            ["fused: nothing was found in any frame with truth; look at the warnings of the run"],
        ),
        (
            of_all(right=0),
            [
                "fused: none of 38 boxes lies where one of 40 true objects of its class does; check that truth and "
                "result are of the same recording and in the same frame of reference"
            ],
        ),
        ({"sources": {}}, []),
        ({"fusion_gain": TAKEN}, []),  # no 2D boxes
        (
            {"sources": {"cameras": SOURCE}, "fusion_gain": TAKEN},
            [
                "fused: car: fusion takes away 0.10 AP (-0.15 to -0.05) from lidar alone; look at the calibration and "
                "the 2D boxes of the cameras, and at the settings fuse"
            ],
        ),
    ],
)
def test_doubts(changed: dict[str, Any], told: list[str]) -> None:
    assert list(map(str, doubts(SOUND | changed, has_truth=True))) == told
    assert doubts(SOUND | changed, has_truth=False) == ()


def test_a_run_whose_lidars_detect_nothing_is_told_so() -> None:
    (figures,) = of_all(found=0, right=0)["sources"].values()
    tree = SOUND | {"sources": {"lidar": figures, "fused": figures}}
    told = list(map(str, doubts(tree, has_truth=True, lidars_detect=False)))
    assert told == [
        "lidar: the run was made with detect3d.method=none, so that the lidars detect nothing; process it again with "
        "another method to compare the lidars with the truth",
        "fused: nothing was found in any frame with truth; look at the warnings of the run",
    ]
