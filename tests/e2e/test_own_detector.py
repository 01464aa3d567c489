"""Engines of the caller's own: functions in place of lidcam's, the same bytes with any number of processes."""

import logging
from pathlib import Path
from typing import Any

import pytest
from helpers import CROSSING
from mcap.reader import make_reader

import lidcam

pytestmark = pytest.mark.slow


ENGINE = '''
"""Cells with many points between knee and head are cars; the middle of each image is one, too."""

import numpy as np

from lidcam import Found2D, Found3D


def find(points):
    low = points[(points[:, 2] > 0.5) & (points[:, 2] < 2.0)]
    cells, counts = np.unique(np.floor(low[:, :2] / 4), axis=0, return_counts=True)
    cells = cells[counts > 60]
    centers = np.column_stack([cells * 4 + 2, np.full(len(cells), 0.8)])
    labels = np.where(cells.sum(1) % 5 == 0, "wall", "car")
    return Found3D(centers, [[4.2, 1.8, 1.6]] * len(cells), np.zeros(len(cells)), np.full(len(cells), 0.8), labels)


def look(image):
    height, width, _ = image.shape
    return Found2D([[0.4 * width, 0.4 * height, 0.6 * width, 0.6 * height]] * 2, [0.7, 0.6], ["car", "kite"])
'''


@pytest.fixture
def engine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """A module that other processes can import, too."""
    (tmp_path / "own_engine.py").write_text(ENGINE, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    import own_engine  # type: ignore[import-not-found]  # written above

    return own_engine


def test_the_functions_are_used_and_the_number_of_processes_changes_no_byte(
    engine: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("lidcam.pipeline.parallel.run.START_S", 0.0)  # no recording is too short for two processes
    engines = {"detector": engine.find, "detector_2d": engine.look}
    results = [tmp_path / f"{workers}.mcap" for workers in (1, 2)]
    for workers, result in enumerate(results, 1):
        run = lidcam.process(CROSSING, result, **engines, workers=workers, duration_s=0.6)
    assert results[0].read_bytes() == results[1].read_bytes()
    sensors, drops = run.summary.sensors, run.summary.drops
    assert (sensors.box_source, sensors.box_source_3d) == ("callable", "callable")
    assert sensors.box_words[0] == "a function of the caller"
    # Also those of frames that were looked at before the run.
    images = sum(count for topic, count in run.summary.inputs.messages_used.items() if "image" in topic)
    assert drops.boxes == {"label 'kite' is of no class": images}
    assert drops.boxes3d["label 'wall' is of no class"] > run.frames
    frame = next(lidcam.iter_frames(CROSSING, detector=engine.find, settings={"track.mode": "none"}, workers=1))
    assert len(frame.detections.lidar) > 10
    assert set(frame.detections.lidar.class_ids.tolist()) == {0}
    with results[0].open("rb") as file:
        (metadata,) = [one.metadata for one in make_reader(file).iter_metadata() if one.name == "lidcam"]
    names = {key: name for key, name in metadata.items() if key.startswith("detector")}
    assert names == {"detector.name": "own_engine.find", "detector_2d.name": "own_engine.look"}
    assert lidcam.load(results[0]).summary.sensors.box_source_3d == "callable"


def test_a_detector_says_nothing_of_classes_that_it_has_no_name_for() -> None:
    def beliefs_in_cars(*labels: str) -> float:
        def look(_: Any) -> lidcam.Found2D:
            return lidcam.Found2D([], [], [])

        look.labels = labels  # type: ignore[attr-defined]
        frames = lidcam.iter_frames(CROSSING, detector_2d=look, workers=1, duration_s=0.3)
        return float(sum(one.beliefs[one.hypotheses.boxes.class_ids == 0].sum() for one in frames))

    assert beliefs_in_cars("person", "car") < 0.8 * beliefs_in_cars("person")


def test_a_function_of_a_script_stays_in_its_process(engine: Any, caplog: pytest.LogCaptureFixture) -> None:
    def find(points: Any) -> lidcam.Found3D:
        found: lidcam.Found3D = engine.find(points)
        return found

    with caplog.at_level(logging.WARNING):
        run = lidcam.process(CROSSING, detector=find, duration_s=0.3)
    (line,) = [record.getMessage() for record in caplog.records if "detector" in record.getMessage()]
    assert "cannot be sent to other processes: define it in a module that they import; until then, one" in line
    assert run.summary.notes == lidcam.process(CROSSING, detector=find, duration_s=0.3, workers=1).summary.notes
    with pytest.raises(lidcam.ConfigError, match=r"cannot be sent to other processes: .*, or set workers to 1$"):
        lidcam.process(CROSSING, detector=find, duration_s=0.3, workers=2)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"detector": 3}, "detector: expected a function, found int"),
        ({"detector": len, "model_3d": "traffic"}, "expected one of detector and model_3d, found both"),
        ({"settings": {"detect2d.method": "callable"}}, "detect2d.method callable: it is `callable` if detector_2d is"),
    ],
)
def test_options_that_contradict_each_other(options: dict[str, Any], message: str) -> None:
    with pytest.raises(lidcam.ConfigError, match=message):
        lidcam.process(CROSSING, **options)
