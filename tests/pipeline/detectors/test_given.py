"""Functions of the caller as engines: what they may return, and what other processes can have."""

import sys
from typing import Any

import numpy as np
import pytest
from frames import frame

from lidcam.pipeline.core.arrays import F32, U8
from lidcam.pipeline.core.errors import ModelError
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.detectors.given import Found2D, Found3D, GivenDetector2D, GivenDetector3D, GivenDetectors

CAR: dict[str, Any] = {
    "centers": [[1, 2, 0.5]],
    "sizes": [[4, 2, 1.5]],
    "yaws": [7],
    "scores": [0.5],
    "labels": ["Car"],
}


def find(_: F32) -> Found3D:
    return Found3D(**CAR)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"centers": [1, 2, 0.5]}, r"centers: expected \[1, 3\] numbers for 1 labels, found \[3\]"),
        ({"labels": ["car", "car"]}, r"centers: expected \[2, 3\] numbers for 2 labels, found \[1, 3\]"),
        ({"labels": "car"}, "labels: expected a name for each box"),
        ({"scores": [1.5]}, r"scores: expected finite numbers in \[0, 1\], found 1.5 to 1.5"),
        ({"sizes": [[4, -2, 1.5]]}, r"sizes: expected finite numbers in \[0, inf\], found -2 to 4"),
        ({"yaws": [np.nan]}, "yaws: expected finite numbers, found nan"),
    ],
)
def test_what_cannot_be_boxes(change: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Found3D(**CAR | change)


def test_records_are_copies_that_nobody_changes() -> None:
    scores = np.array([0.5], np.float32)
    found = Found3D(**CAR | {"scores": scores})
    scores[0] = 0.9
    assert found.scores.tolist() == [0.5]
    assert found.scores.dtype == np.float64
    assert not found.centers.flags.writeable
    assert len(Found3D([], [], [], [], []).centers) == len(Found2D([], [], []).xyxy) == 0


def test_a_cloud_with_its_ground_goes_in_and_labels_of_no_class_are_counted() -> None:
    combined = frame(0).combined
    seen: list[F32] = []

    def watched(points: F32) -> Found3D:
        seen.append(points)
        return Found3D([[1, 2, 0.5]] * 3, [[4, 2, 1.5]] * 3, [0] * 3, [0.5] * 3, ["CAR ", "tram", "pedestrian"])

    detector = GivenDetector3D(watched, config := Config())
    found = detector(combined)
    assert found.class_ids.tolist() == [config.class_names.index("car"), -1, config.class_names.index("pedestrian")]
    assert detector.unused == {"label 'tram' is of no class": 1}
    assert seen[0].dtype == np.float32
    clouds = combined.detection_cloud, combined.ground_cloud
    np.testing.assert_array_equal(seen[0][:, :3], np.concatenate([cloud.xyz for cloud in clouds]))
    np.testing.assert_array_equal(seen[0][:, 3], np.concatenate([cloud.intensity for cloud in clouds]))


def test_images_go_in_one_by_one() -> None:
    images = [np.full((4, 6, 3), value, np.uint8) for value in (1, 2)]

    def look(image: U8) -> Found2D:
        labels = ["car", "sofa"][: int(image[0, 0, 0])]
        return Found2D([[0, 0, 5, 3]] * len(labels), [0.5] * len(labels), labels)

    detector = GivenDetector2D(look, Config())
    one, two = detector(images)
    assert [detector.labels[row] for row in one.labels] == ["car"]
    assert [detector.labels[row] for row in two.labels] == ["car", ""]
    assert detector.unused == {"label 'sofa' is of no class": 1}
    for names in (("person", "bicycle"), np.array(["person", "bicycle"]), {0: "person", 1: "bicycle"}):
        look.labels = names  # type: ignore[attr-defined]  # as a network has them
        assert GivenDetector2D(look, Config()).labels == ("person", "bicycle", "")


def test_something_else_is_an_error_that_names_the_function() -> None:
    detector: Any = GivenDetector3D(lambda points: points, Config())  # type: ignore[arg-type,return-value]
    with pytest.raises(ModelError, match=r"^detector .*<lambda>: expected a lidcam\.Found3D from it, found ndarray$"):
        detector(frame(0).combined)


def test_what_other_processes_can_have(monkeypatch: pytest.MonkeyPatch) -> None:
    assert GivenDetectors().unsendable == ""
    given = GivenDetectors(find)
    assert (given.unsendable, given.names) == ("", {"detector": f"{__name__}.find"})
    cannot = "cannot be sent to other processes: define it in a module that they import"
    assert cannot in GivenDetectors(in_images=lambda _: Found2D([], [], [])).unsendable
    monkeypatch.setattr(sys.modules["__main__"], "find", find, raising=False)
    monkeypatch.setattr(find, "__module__", "__main__")  # of a script: it can be pickled, and not found elsewhere
    assert given.unsendable == f"detector __main__.find {cannot}"
