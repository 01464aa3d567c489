import numpy as np
from detections import boxes2d
from seen_boxes import camera_at, views_of

from lidcam.pipeline.core.detections import Matches
from lidcam.pipeline.fusion.cameras.sightings import see
from lidcam.pipeline.fusion.proposals.partners import find_duplicates, find_partners

VIEWS = views_of(camera_at("a", (0.0, 0.0, 2.0)), camera_at("b", (0.0, 0.0, 2.0)))
LOW, HIGH = (100.0, 100, 200, 200, 0.3, 0), (300.0, 100, 400, 200, 0.9, 0)


def matched(*pairs: tuple[int, int, float]) -> Matches:
    table = np.array(pairs, np.float64).reshape(-1, 3)
    nothing = np.full((9, 4), np.nan, np.float32)
    return Matches(
        table[:, :2].astype(np.int64),
        table[:, 2].astype(np.float32),
        nothing,
        np.zeros(9, np.float32),
        np.zeros((9, 4), np.float32),
    )


def test_rows_are_those_of_the_2d_boxes_however_they_are_ordered() -> None:
    sightings = see(VIEWS, {"a": boxes2d([LOW, HIGH]), "b": boxes2d([HIGH])})
    partner = find_partners(sightings, {"a": matched((7, 0, 0.5)), "b": matched((2, 0, 0.75))}, ("a", "b"))
    assert sightings.rows.tolist() == [1, 0, 0]
    assert partner.tolist() == [-1, 7, 2]


def test_camera_without_boxes_or_matches() -> None:
    sightings = see(VIEWS, {"b": boxes2d([LOW])})
    partner = find_partners(sightings, {"a": matched(), "b": matched()}, ("a", "b"))
    assert partner.tolist() == [-1]


def test_second_box_around_a_matched_object_is_a_duplicate() -> None:
    near, beside = (102.0, 102, 203, 203, 0.8, 3), (150.0, 100, 250, 200, 0.7, 0)
    boxes = boxes2d([LOW, near, beside])
    sightings = see(VIEWS, {"a": boxes, "b": boxes})
    partner = find_partners(sightings, {"a": matched((0, 0, 0.9)), "b": matched()}, ("a", "b"))
    duplicates = find_duplicates(sightings, partner)
    assert [(int(sightings.cameras[k]), int(sightings.rows[k])) for k in np.flatnonzero(duplicates)] == [(0, 1)]
