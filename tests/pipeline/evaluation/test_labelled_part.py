import numpy as np
import numpy.typing as npt
import pytest
from evaluation_frames import frame_of, rows_at, source_boxes, truth_boxes

from lidcam.pipeline.core.camera import CameraModel
from lidcam.pipeline.core.geometry.transform import Transform
from lidcam.pipeline.core.rig import CameraSensor
from lidcam.pipeline.core.settings.evaluate import EvaluateConfig
from lidcam.pipeline.evaluation.ignoring import is_within
from lidcam.pipeline.evaluation.labelled_part import LabelledPart, LabelledPartSearch

Places = list[tuple[float, float]]
AHEAD = [(8.0 + 4 * n, (-1.0) ** n) for n in range(10)]
ALL_ROUND = [(x, y) for x in (-30.0, -10.0, 10.0, 30.0) for y in (-5.0, 5.0)]


def camera(R: npt.ArrayLike) -> CameraSensor:
    """1.5 m above the site, 90 degrees wide."""
    T, K = np.eye(4), np.array([[320.0, 0, 320], [0, 320, 240], [0, 0, 1]])
    T[:3, :3] = R
    T[:3, 3] = -T[:3, 2] * 1.5
    model = CameraModel("eye", 640, 480, K, "plumb_bob", np.zeros(5))
    return CameraSensor("eye", "", "", model, Transform("eye", "site", T))


LEVEL, DOWN = [[0, -1, 0], [0, 0, -1], [1, 0, 0]], [[0, -1, 0], [-1, 0, 0], [0, 0, -1]]


def part(truth: Places, found: Places, R: npt.ArrayLike = LEVEL) -> LabelledPart | None:
    """Of five frames of the same objects."""
    search, sources = LabelledPartSearch([camera(R)]), {"lidar": source_boxes(rows_at(found))}
    frames = (frame_of(k, truth_boxes(rows_at(truth), range(len(truth))), sources) for k in range(5))
    return search.found() if all(map(search.add_frame, frames)) else None


def test_truth_in_one_view_alone() -> None:
    found = part(AHEAD, ALL_ROUND)
    assert found is not None
    assert (found.camera, found.max_range_m) == ("eye", 45)
    config = EvaluateConfig.model_validate({"region": found.region, "max_range_m": found.max_range_m})
    places = np.array([[9, 8, 0], [9, -8, 0], [44, 0, 0], [9, 10, 0], [9, -10, 0], [-9, 0, 0], [46, 0, 0]])
    assert is_within(places.astype(float), config).tolist() == [True] * 3 + [False] * 4


@pytest.mark.parametrize(
    ("truth", "found", "R"),
    [
        pytest.param([*AHEAD, (-20.0, 0.0)], ALL_ROUND, LEVEL, id="one object is behind"),
        pytest.param(AHEAD[:7], ALL_ROUND, LEVEL, id="few objects"),
        pytest.param(AHEAD, AHEAD, LEVEL, id="lidars see nothing elsewhere either"),
        pytest.param(AHEAD, [*AHEAD, *ALL_ROUND[:4]], LEVEL, id="chance may explain it"),
        pytest.param([(0.0, 0.0)] * 9, ALL_ROUND, DOWN, id="a camera that looks down"),
        pytest.param([], ALL_ROUND, LEVEL, id="no objects"),
    ],
)
def test_truth_that_may_be_labelled_all_round(truth: Places, found: Places, R: npt.ArrayLike) -> None:
    assert part(truth, found, R) is None
