"""What people look at: scenes, markers, annotations, diagnostics."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from detections import boxes3d, forward_camera
from frames import CONFIG, COVARIANCE, RIG, START_NS, frame, through_cdr, tracks_of
from hypothesis import given
from hypothesis import strategies as st

from lidcam.pipeline.core.detections import Fused, Source
from lidcam.pipeline.core.frame import FrameResult, Missing
from lidcam.pipeline.core.geometry.boxes import box_corners
from lidcam.pipeline.core.geometry.transform import Transform
from lidcam.pipeline.core.messages import Drop
from lidcam.pipeline.core.optics.drawn_edges import draw_edges
from lidcam.pipeline.core.rig import CameraSensor
from lidcam.writers.drawing import ARROW_SHARE, ELLIPSE_CORNERS, DrawnObjects, ground_ellipses, object_edges
from lidcam.writers.messages.annotations import image_annotations
from lidcam.writers.messages.diagnostics import diagnostics
from lidcam.writers.messages.scene import marker_array, scene_update, zone_entities
from lidcam.writers.palette import CAMERA_ONLY, MATCHED, class_color
from lidcam.writers.trails import Trails
from lidcam.writers.viewpoint import SceneSurvey

NAMES, UPWARDS = CONFIG.class_names, np.array([0.0, 0.0, 0.5])


def scene_of(*results: FrameResult) -> Any:
    """The scene of the last of some frames."""
    trails = Trails("site", CONFIG.combine.motion)
    for one in results:
        drawn, behind = drawn_of(one), trails.add_frame(one)
    return through_cdr(scene_update(drawn, behind, drawn.roofs + UPWARDS))


def drawn_of(result: FrameResult) -> DrawnObjects:
    return DrawnObjects.of(result, NAMES)


@pytest.mark.parametrize("objects", [0, 1, 3])
def test_a_scene_starts_with_the_deletion_of_the_one_before(objects: int) -> None:
    result = frame(objects=objects)
    scene = scene_of(result)
    assert [(d.type, d.id) for d in scene.deletions] == [(scene.deletions[0].ALL, "")]
    assert len({entity.id for entity in scene.entities}) == objects
    for row, entity in enumerate(scene.entities):
        (cube,) = entity.cubes
        place, boxes = cube.pose.position, result.fused.objects
        np.testing.assert_allclose([cube.size.x, cube.size.y, cube.size.z], boxes.sizes[row])
        np.testing.assert_allclose([place.x, place.y, place.z], boxes.centers[row])
        assert (entity.frame_id, entity.timestamp.nanosec) == ("site", START_NS % 10**9)
        for text in entity.texts:
            assert text.pose.position.z > cube.pose.position.z + cube.size.z / 2
            assert text.text.startswith(NAMES[result.fused.objects.class_ids[row]])


def test_confirmed_objects_are_denser_and_say_by_how_many_cameras() -> None:
    entities = scene_of(frame()).entities  # confirmed by 2, 1 and 0 cameras
    alphas = [entity.cubes[0].color.a for entity in entities]
    assert alphas[0] == alphas[1] > alphas[2] > 0
    thickness = [entity.lines[0].thickness for entity in entities]
    assert thickness[0] == thickness[1] > thickness[2] > 0
    labels = [[text.text for text in entity.texts] for entity in entities]
    assert labels == [["car 0.90 (2 cam)"], ["pedestrian 0.50 (1 cam)"], []]


MIXED = (Source.BOTH, Source.CAMERA, Source.LIDAR)


def test_what_the_cameras_alone_place_is_thinner_and_says_how_sure_its_place_is() -> None:
    result = frame(sources=MIXED)
    both, placed, faint = scene_of(result).entities
    assert both.cubes[0].color.a > placed.cubes[0].color.a > faint.cubes[0].color.a
    assert [len(entity.lines) for entity in (both, placed, faint)] == [2, 3, 1]  # two with lines to their labels
    assert both.lines[0].thickness > placed.lines[0].thickness == placed.lines[1].thickness
    ellipse = np.array([(point.x, point.y, point.z) for point in placed.lines[1].points])
    objects = result.fused.objects
    away = ellipse[:, :2] - objects.centers[1, :2]
    np.testing.assert_allclose(np.einsum("ni,ij,nj->n", away, np.linalg.inv(COVARIANCE[:2, :2]), away), 1.0)
    np.testing.assert_allclose(ellipse[:, 2], objects.centers[1, 2] - objects.sizes[1, 2] / 2)
    assert [text.text for text in placed.texts] == ["pedestrian 0.50 (1 cam, no lidar)"]


def facts_of(scene: Any) -> list[dict[str, str]]:
    return [{pair.key: pair.value for pair in entity.metadata} for entity in scene.entities]


def markers_of(result: FrameResult) -> Any:
    return through_cdr(marker_array(drawn_of(result))).markers


def with_objects(result: FrameResult, **fields: Any) -> FrameResult:
    return replace(result, fused=replace(result.fused, objects=replace(result.fused.objects, **fields)))


def test_viewers_say_what_the_geometry_of_an_object_comes_from() -> None:
    result = frame(sources=MIXED)
    told = [(one["source"], one["cameras"]) for one in facts_of(scene_of(result))]
    assert told == [("both", "2"), ("camera", "1"), ("lidar", "0")]
    shown = [(marker.ns, marker.id) for marker in markers_of(result)[1::2]]
    assert shown == [("objects/both", 0), ("objects/camera", 1), ("objects/lidar", 2)]


PREDICTED = (Source.BOTH, Source.LIDAR, Source.PREDICTED)
TRACKS = tracks_of([12, 0, 7], [[3.0, 4.0], [0.0, 0.0], [0.01, -0.02]])
SURE = np.full(3, 0.9, np.float32)


def test_a_track_is_the_same_entity_in_all_scenes_and_says_what_it_is() -> None:
    scene = scene_of(frame(tracks=TRACKS))
    assert [entity.id for entity in scene.entities] == ["track-12", "object-1", "track-7"]
    told, of_track = facts_of(scene), {"track": "12", "speed_m_s": "5.00", "existence": "0.7500", "age_s": "1.25"}
    assert told[0].items() >= of_track.items()
    assert {told[1][key] for key in of_track} == {""}
    assert "track" not in facts_of(scene_of(frame()))[0]


def test_labels_of_tracks_are_number_and_speed() -> None:
    result = with_objects(frame(tracks=TRACKS), scores=SURE)
    assert drawn_of(result).labels == ["car #12, 5.0 m/s", "pedestrian 0.90 (1 cam)", "truck #7"]
    assert [marker.text for marker in markers_of(result)[2::2]] == drawn_of(result).labels
    texts = [text.text for text in annotations(result).texts]
    # The matched object's, that of an object without a 2D box, and the detector's.
    assert texts == ["car #12, 5.0 m/s", "pedestrian 0.90 (1 cam)", "pedestrian 0.50"]


def test_a_predicted_object_is_thinner_and_fainter() -> None:
    result = with_objects(frame(sources=PREDICTED, tracks=TRACKS), scores=SURE)
    both, _, predicted = scene_of(result).entities
    assert both.cubes[0].color.a > predicted.cubes[0].color.a > 0
    assert both.lines[0].thickness > predicted.lines[0].thickness == predicted.lines[1].thickness
    assert max(rgb(predicted.lines[0].color)) < max(class_color(3))
    assert [text.text for text in predicted.texts] == ["truck #7 (predicted)"]
    shown = [(marker.ns, marker.id) for marker in markers_of(result)[1::2]]
    assert shown == [("objects/both", 12), ("objects/lidar", -2), ("objects/predicted", 7)]


@pytest.mark.parametrize(
    ("along_m_s", "is_known", "beyond_m"), [(0.0, True, 0.0), (6.0, True, 6.0), (-6.0, True, 0.0), (6.0, False, None)]
)
def test_arrows_of_tracks_reach_as_far_as_they_move(along_m_s: float, is_known: bool, beyond_m: float | None) -> None:
    yaw = frame().fused.objects.yaws[0]
    tracks = tracks_of([1], [[along_m_s * np.cos(yaw), along_m_s * np.sin(yaw)]], [is_known])
    result = frame(objects=1, tracks=tracks)
    found = [arrow.shaft_length + arrow.head_length for arrow in scene_of(result).entities[0].arrows]
    standing_m = ARROW_SHARE * result.fused.objects.sizes[0, 0]
    assert found == ([] if beyond_m is None else [pytest.approx(standing_m + beyond_m)])


def test_the_trail_of_a_track_is_a_line_in_its_colour() -> None:
    first, second = frame(0, tracks=TRACKS), frame(1, tracks=TRACKS)
    moved = with_objects(second, centers=second.fused.objects.centers + np.array([1.0, 0.0, 0.0]))
    one, other, _ = scene_of(first, moved).entities
    assert [line.type for line in one.lines] == [one.lines[0].LINE_LIST] + [one.lines[0].LINE_STRIP] * 2
    assert [(point.x, point.y, point.z) for point in one.lines[1].points] == [(10, 1.5, -0.65), (11, 1.5, -0.65)]
    assert rgb(one.lines[1].color) == class_color(0)
    assert [line.type for line in other.lines] == [one.lines[0].LINE_LIST, one.lines[0].LINE_STRIP]  # edges, label


def test_without_tracks_no_front_is_known() -> None:
    assert [entity.arrows for entity in scene_of(frame()).entities] == [[], [], []]


def test_a_2d_box_is_faint_where_a_3d_box_is_drawn() -> None:
    matched, alone = annotations(frame()).points[2:]
    assert (rgb(matched.outline_color), rgb(alone.outline_color)) == (MATCHED, CAMERA_ONLY)
    assert matched.outline_color.a < alone.outline_color.a == 1.0
    assert matched.thickness < alone.thickness


@pytest.mark.parametrize("objects", [0, 3])
def test_zones_lie_on_the_ground_with_their_counts(objects: int) -> None:
    survey, result = SceneSurvey(RIG), frame(objects=objects)
    survey.add_frame(result)
    drawn, zones = drawn_of(result), zone_entities(survey, result.fused.objects)
    scene = scene_update(drawn, [np.zeros((0, 3))] * objects, drawn.roofs, zones)
    north, south = through_cdr(scene).entities[objects:]
    assert [entity.texts[0].text for entity in (north, south)] == [f"intersection: {min(objects, 2)}", "circle: 0"]
    assert {point.z for entity in (north, south) for point in entity.lines[0].points} == {survey.ground_m}
    assert min(point.y for point in north.lines[0].points) == 0.0


def test_a_rig_without_zones_has_none_drawn() -> None:
    assert zone_entities(SceneSurvey(replace(RIG, zones=())), frame().fused.objects) == []


def test_arrows_leave_the_front_of_the_boxes() -> None:
    result = frame(tracks=tracks_of([1, 2, 3], fronts_known=True))
    for row, entity in enumerate(scene_of(result).entities):
        ((arrow,), (cube,), (edges, *_)) = entity.arrows, entity.cubes, entity.lines
        assert arrow.pose == cube.pose == edges.pose
        length = result.fused.objects.sizes[row, 0]
        assert length / 2 < arrow.shaft_length + arrow.head_length < length
        corners = np.array([[point.x, point.y, point.z] for point in edges.points])
        np.testing.assert_allclose(np.abs(corners), np.tile(result.fused.objects.sizes[row] / 2, (8, 1)))
        assert len(edges.indices) == 24
        assert edges.type == edges.LINE_LIST


@pytest.mark.parametrize("objects", [0, 3])
def test_markers_delete_all_first(objects: int) -> None:
    markers = markers_of(frame(objects=objects))
    assert [marker.action for marker in markers] == [3] + [0] * (2 * objects)
    assert len({(marker.ns, marker.id) for marker in markers[1:]}) == 2 * objects
    assert all(marker.header == markers[0].header for marker in markers)
    assert all(marker.text for marker in markers if marker.ns == "labels")


def annotations(result: FrameResult, camera: CameraSensor = RIG.cameras[0]) -> Any:
    edges = object_edges(result, [camera.name])[camera.name]
    return through_cdr(image_annotations(drawn_of(result), camera, edges, stamp_ns=START_NS + 5))


def rgb(color: Any) -> tuple[float, float, float]:
    return color.r, color.g, color.b


def test_annotations_of_a_camera_with_a_match() -> None:
    drawn = annotations(frame())
    stamps = {(part.timestamp.sec, part.timestamp.nanosec) for part in (drawn, *drawn.points, *drawn.texts)}
    assert stamps == {divmod(START_NS + 5, 10**9)}
    edges, boxes = drawn.points[:2], drawn.points[2:]  # two of the three objects are in view
    assert [part.type for part in drawn.points] == [edges[0].LINE_LIST] * 2 + [edges[0].LINE_LOOP] * 2
    assert [rgb(part.outline_color) for part in edges] == [class_color(0), class_color(1)]
    assert all(len(part.points) % 2 == 0 for part in edges)
    assert [rgb(part.outline_color) for part in boxes] == [MATCHED, CAMERA_ONLY]
    corners = [(200.5, 150), (300.25, 150), (300.25, 250), (200.5, 250)]
    assert [(point.x, point.y) for point in boxes[0].points] == corners


def test_a_matched_box_is_labelled_as_its_object_and_another_as_the_detector_s() -> None:
    result = with_objects(frame(), class_ids=np.array([3, 1, 3], np.int32))  # the detector said car, 0.75
    texts = annotations(result).texts
    found = [(text.text, rgb(text.text_color)) for text in texts]
    alone = ("pedestrian 0.50 (1 cam)", class_color(1))  # an object without a 2D box
    assert found == [("truck 0.90", MATCHED), alone, ("pedestrian 0.50", CAMERA_ONLY)]


def test_a_box_whose_object_is_not_reported_is_the_camera_s_alone() -> None:
    result = frame()
    rows = np.array([1, 2])
    fused = Fused(result.fused.objects.select(rows), result.fused.matched[rows], rows.astype(np.int64))
    drawn = annotations(replace(result, fused=fused))
    assert [text.text for text in drawn.texts] == ["car 0.75", "pedestrian 0.50 (1 cam)", "pedestrian 0.50"]
    assert rgb(drawn.points[-2].outline_color) == CAMERA_ONLY


@pytest.mark.parametrize(("size_px", "labels"), [((640, 480), 3), ((2880, 2160), 2), ((480, 640), 3)])
def test_letters_and_lines_grow_with_the_image(size_px: tuple[int, int], labels: int) -> None:
    camera, short_px = forward_camera("left", size_px=size_px), min(size_px)
    result = frame()
    drawn = annotations(replace(result, views={**result.views, "left": camera}), camera)
    assert {text.font_size for text in drawn.texts} == {short_px / 24}
    assert all(text.position.y >= text.font_size for text in drawn.texts)
    assert {part.thickness for part in drawn.points} == {short_px / 300, short_px / 600}
    assert len(drawn.texts) == labels  # a box of 40 px is lower than letters of 90


def test_objects_are_drawn_from_where_the_image_was_taken() -> None:
    result, camera = frame(), RIG.cameras[0]
    shift = np.eye(4)
    shift[0, 3] = -2.0
    nearer = Transform(camera.T_camera_site.dst, "site", camera.T_camera_site.matrix @ shift)
    moved = replace(result, views={**result.views, camera.name: replace(camera, T_camera_site=nearer)})
    still, drawn = (np.array([(p.x, p.y) for p in annotations(one).points[0].points]) for one in (result, moved))
    objects = result.fused.objects.select(np.array([0]))
    corners = nearer.apply(box_corners(objects.centers, objects.sizes, objects.yaws))
    expected, _ = draw_edges([camera.model], np.asarray(corners, np.float64), np.zeros(len(corners), np.intp))
    np.testing.assert_allclose(drawn, expected.reshape(-1, 2), atol=1e-3)
    assert np.abs(np.ptp(drawn, axis=0)).min() > 1.1 * np.abs(np.ptp(still, axis=0)).min()


def test_diagnostics() -> None:
    drops = (Drop("/left/image", 1, "cannot be decoded", "12 bytes"), Drop("/left/image", 2, "too late"))
    result = frame(4, drops=drops[:1])
    late = replace(result.bundle, dropped_before={("/right/image", "no partner"): 3})
    message = through_cdr(diagnostics(replace(result, bundle=late), RIG, drops[1:]))
    found = {status.name: [(pair.key, pair.value) for pair in status.values] for status in message.status}
    offset, left_out = ("offset_ms /left/image", "1.000"), ("left out /right/image", "3: no partner")
    assert {("skew_ms", "5.000"), ("frame", "4"), offset, left_out} <= {*found["lidcam: synchronisation"]}
    assert {("points outliers", "10"), ("motion compensated", "lidar1")} <= {*found["lidcam: cloud"]}
    expected = {("fused", "3"), ("confirmed by cameras", "2"), ("detected left", "2"), ("matched right", "0")}
    assert expected <= {*found["lidcam: objects"]}
    told = [("/left/image", "cannot be decoded: 12 bytes"), ("/left/image", "too late")]
    assert found["lidcam: dropped messages"] == told
    assert [status.level for status in message.status] == [0, 0, 0, 1]


def test_diagnostics_count_tracks() -> None:
    found = [
        {pair.key: pair.value for pair in through_cdr(diagnostics(result, RIG, ())).status[2].values}
        for result in (frame(sources=PREDICTED, tracks=TRACKS), frame())
    ]
    assert (found[0]["tracks"], found[0]["predicted"]) == ("2", "1")
    assert not {"tracks", "predicted"} & found[1].keys()


@pytest.mark.parametrize(("why", "level"), [(Missing.NOT_NEAR, 0), (Missing.SILENT, 1)])
def test_diagnostics_name_the_sensors_that_are_missing(why: Missing, level: int) -> None:
    result = frame(4)
    kept = {topic: message for topic, message in result.bundle.messages.items() if topic != "/left/image"}
    partial = replace(result, bundle=replace(result.bundle, messages=kept, missing={"/left/image": why}))
    status = through_cdr(diagnostics(partial, RIG, ())).status[0]
    assert (status.message, status.level) == ("skew 5.000 ms, without left", level)
    assert ("missing left", why) in [(pair.key, pair.value) for pair in status.values]


@pytest.mark.parametrize("aside_m", np.linspace(-60, 60, 25).tolist())
def test_what_is_left_out_before_projection_is_not_in_the_image(aside_m: float) -> None:
    result = frame()
    camera = result.views[RIG.cameras[0].name]
    result = with_objects(result, centers=result.fused.objects.centers + np.array([0.0, aside_m, 0.0]))
    moved = result.fused.objects
    corners = camera.T_camera_site.apply(box_corners(moved.centers, moved.sizes, moved.yaws))
    expected, rows = draw_edges([camera.model], np.asarray(corners, np.float64), np.zeros(len(corners), np.intp))
    drawn = object_edges(result, [camera.name])[camera.name]
    np.testing.assert_array_equal(drawn[0], expected)
    np.testing.assert_array_equal(drawn[1], rows)


FACTORS = st.floats(0.01, 10.0)


@given(st.tuples(FACTORS, st.floats(-10.0, 10.0), FACTORS))
def test_points_are_one_standard_deviation_away(factor: tuple[float, float, float]) -> None:
    along, shear, across = factor
    lower = np.array([[along, 0.0], [shear, across]])
    covariance = np.zeros((2, 3, 3))
    covariance[1, :2, :2] = lower @ lower.T
    boxes = replace(boxes3d([[0.0, 0, 0, 1, 1, 1, 0], [5.0, -3, 2, 4, 2, 1.5, 1]]), covariances=covariance)
    unknown, known = ground_ellipses(boxes)
    np.testing.assert_array_equal(unknown, np.tile([0.0, 0.0, -0.5], (ELLIPSE_CORNERS, 1)))
    away = np.linalg.solve(lower, (known[:, :2] - [5, -3]).T)
    np.testing.assert_allclose(np.linalg.norm(away, axis=0), 1.0, rtol=1e-6)
    np.testing.assert_allclose(known[:, 2], 2 - 0.75)
