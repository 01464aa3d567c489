"""A run's bookkeeping: every message of a topic in use ends in a set or in the drop table."""

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from builders import image, odometry, pointcloud2, raw
from hypothesis import given, settings
from hypothesis import strategies as st
from memory_recording import MemoryRecording
from reports import changed, printed

from lidcam.pipeline.core.camera import CameraModel
from lidcam.pipeline.core.errors import ConfigError, RecordingError
from lidcam.pipeline.core.frame import FrameResult
from lidcam.pipeline.core.geometry.transform import Transform
from lidcam.pipeline.core.geometry.transform_tree import TransformTree
from lidcam.pipeline.core.messages import RawMessage
from lidcam.pipeline.core.rig import CameraSensor, LidarSensor, Rig
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.core.settings.track import TrackConfig
from lidcam.pipeline.evaluation.road_users import RoadUserCount, RoadUsers, ZoneChange
from lidcam.processing import Run
from lidcam.readers.messages.tf import RecordedTransforms
from lidcam.readers.rig.discovery import Discovery
from lidcam.readers.streams.motion import MotionSource
from lidcam.run.frames import RunInput, TimeWindow, synchronized_topics
from lidcam.run.summary import RunSummary, summary_tree
from lidcam.run.tally import DropTable, Tally

STEP_NS = 100_000_000
START_NS = 1_600_000_000_000_000_000
FRONT, REAR, IMAGES, ODOMETRY = "/front/points", "/rear/points", "/cam/image_raw", "/odom"
IN_USE = (FRONT, REAR, IMAGES)
POLICIES = ("approximate_time", "approximate_time_python", "nearest")


def config(**sync: object) -> Config:
    return Config.model_validate({"sync": sync, "detect3d": {"method": "none"}, "run": {"workers": 1}})


def rig(*, image_offset_ns: int = 0) -> Rig:
    model = CameraModel("cam", 8, 6, np.array([[8.0, 0, 4], [0, 8, 3], [0, 0, 1]]), "plumb_bob", np.zeros(0))
    lidars = tuple(
        LidarSensor(name, f"/{name}/points", Transform.identity("base_link", name)) for name in ("front", "rear")
    )
    camera = CameraSensor("cam", IMAGES, "", model, Transform.identity("cam", "base_link"), image_offset_ns)
    return Rig("base_link", lidars, (camera,), ())


def message(topic: str, stamp_ns: int, log_time_ns: int, *, points: int = 3) -> RawMessage:
    if topic == IMAGES:
        pixels = np.zeros((6, 8, 3), np.uint8)
        return raw(topic, "sensor_msgs/msg/Image", image(pixels, stamp_ns=stamp_ns), stamp_ns, log_time_ns)
    if topic == ODOMETRY:
        pose = odometry(stamp_ns=stamp_ns, position=((stamp_ns - START_NS) / 1e9, 0, 0))
        return raw(topic, "nav_msgs/msg/Odometry", pose, stamp_ns, log_time_ns)
    cloud = pointcloud2(np.ones((points, 3), np.float32), stamp_ns=stamp_ns, frame_id=topic.split("/")[1])
    return raw(topic, "sensor_msgs/msg/PointCloud2", cloud, stamp_ns, log_time_ns)


def broken(whole: RawMessage) -> RawMessage:
    return whole._replace(data=bytes(whole.data)[:-5])


def periodic(topics: Sequence[str] = IN_USE, count: int = 6) -> list[RawMessage]:
    return [message(topic, START_NS + k * STEP_NS, START_NS + k * STEP_NS) for k in range(count) for topic in topics]


def run(
    messages: list[RawMessage],
    settings: Config,
    *,
    motion: MotionSource | None = None,
    window: TimeWindow | None = None,
    sensors: Rig | None = None,
) -> tuple[RunSummary, list[FrameResult]]:
    source = RunInput(MemoryRecording(messages), sensors or rig(), settings, motion, window or TimeWindow())
    pass_over = Run(source, Discovery(source.rig, (), (), (), RecordedTransforms(TransformTree())), DropTable())
    frames: list[FrameResult] = [*pass_over.frames([])]
    return pass_over.summary(), frames


def drop_counts(report: RunSummary) -> dict[tuple[str, str], int]:
    return {(drop.topic, drop.reason): drop.count for drop in report.drops.messages}


def subjects(report: RunSummary) -> list[str]:
    return [warning.subject for warning in report.warnings]


def assert_all_accounted_for(summary: RunSummary, messages: Sequence[RawMessage], topics: Sequence[str]) -> None:
    recorded = Counter(m.topic for m in messages if m.topic in topics)
    dropped: Counter[str] = Counter()
    for drop in summary.drops.messages:
        dropped[drop.topic] += drop.count
    assert {t: summary.inputs.messages_used.get(t, 0) + dropped[t] for t in recorded} == dict(recorded)


@pytest.mark.parametrize("policy", POLICIES)
@given(
    st.lists(
        st.tuples(
            st.sampled_from(IN_USE), st.integers(0, 60), st.integers(0, 20), st.sampled_from([False] * 5 + [True])
        ),
        min_size=5,
        max_size=40,
    ),
    st.integers(1, 3),
)
@settings(max_examples=25)
def test_every_message_is_used_or_dropped(
    policy: str, recorded: list[tuple[str, int, int, bool]], queue_size: int
) -> None:
    messages = periodic(count=2)
    for topic, at, late, is_bad in recorded:
        stamp_ns = START_NS + at * 10_000_000
        whole = message(topic, stamp_ns, stamp_ns + late * 10_000_000)
        messages.append(broken(whole) if is_bad else whole)
    try:
        summary, frames = run(messages, config(policy=policy, queue_size=queue_size))
    except RecordingError:
        return  # not one set: told as such
    assert summary.frames.count == len(frames)
    assert_all_accounted_for(summary, messages, IN_USE)


def test_messages_of_the_motion_are_no_part_of_the_sets_and_bad_ones_are_counted() -> None:
    messages = periodic((ODOMETRY, *IN_USE))
    bad = next(i for i, m in enumerate(messages) if m.topic == ODOMETRY and m.stamp_ns == START_NS + 2 * STEP_NS)
    messages[bad] = broken(messages[bad])
    source = MotionSource((ODOMETRY,), "base_link", "odom", ("base_link",))
    summary, frames = run(messages, config(), motion=source)
    assert_all_accounted_for(summary, messages, IN_USE)
    assert drop_counts(summary) == {(ODOMETRY, "cannot be decoded"): 1}
    assert all(frame.bundle.motion is not None for frame in frames[1:])
    assert all(ODOMETRY not in frame.bundle.messages for frame in frames)


def test_a_window_counts_only_what_was_recorded_in_it() -> None:
    messages = periodic()
    window = TimeWindow(START_NS + STEP_NS, START_NS + 4 * STEP_NS)
    summary, frames = run(messages, config(), window=window)
    inside = [m for m in messages if START_NS + STEP_NS <= m.log_time_ns < START_NS + 4 * STEP_NS]
    assert [frame.bundle.stamp_ns for frame in frames] == [START_NS + k * STEP_NS for k in (1, 2, 3)]
    assert_all_accounted_for(summary, inside, IN_USE)


def test_a_bad_cloud_leaves_the_rest_of_its_set() -> None:
    messages = periodic()
    messages[4] = broken(messages[4])  # the rear lidar's second cloud
    assert messages[4].topic == REAR
    summary, frames = run(messages, config())
    assert summary.inputs.messages_used == {FRONT: 6, IMAGES: 6, REAR: 5}
    assert drop_counts(summary) == {(REAR, "cannot be decoded"): 1}
    assert frames[1].combined.counts["input"] == 3
    assert REAR in summary.drops.messages[0].example


def test_no_set_at_all_names_the_messages_by_topic() -> None:
    with pytest.raises(RecordingError, match=rf"{FRONT} 6, {REAR} 6, {IMAGES} 0"):
        run(periodic((FRONT, REAR)), config(required="all"))


@pytest.mark.parametrize("required", ["all", "lidars", [], [IMAGES]])
@pytest.mark.parametrize("window", [TimeWindow(START_NS + 1, START_NS + 2), TimeWindow(START_NS + 10**12)])
def test_a_part_without_messages_is_refused_with_one_line(required: object, window: TimeWindow) -> None:
    with pytest.raises(RecordingError, match="given by start and duration, found none in it; take a longer"):
        run(periodic(), config(required=required), window=window)


@pytest.mark.parametrize(
    ("sync", "fault"),
    [
        ({"reference": "/nothing"}, "sync.reference: '/nothing' is not among the topics in use: /front/points, "),
        ({"required": ["/nothing"]}, "sync.required: /nothing is not among the topics in use: /front/points, "),
        ({"required": [IMAGES], "reference": "/nothing"}, "sync.reference: '/nothing'"),
    ],
)
def test_the_reference_and_required_topics_have_to_be_in_use(sync: dict[str, object], fault: str) -> None:
    with pytest.raises(ConfigError, match=fault):
        run(periodic(), config(**sync))


def test_the_reference_gives_stamp_and_log_time() -> None:
    messages = [
        message(topic, START_NS + k * STEP_NS + shift, START_NS + k * STEP_NS + 2 * shift)
        for k in range(4)
        for topic, shift in ((FRONT, 0), (REAR, 3_000_000), (IMAGES, 7_000_000))
    ]
    _, frames = run(messages, config(reference=IMAGES))
    assert [frame.bundle.stamp_ns for frame in frames] == [START_NS + k * STEP_NS + 7_000_000 for k in range(4)]
    assert [frame.bundle.log_time_ns for frame in frames] == [START_NS + k * STEP_NS + 14_000_000 for k in range(4)]
    assert {frame.bundle.skew_ns for frame in frames} == {7_000_000}


def test_images_take_part_only_where_they_are_copied_or_looked_at() -> None:
    settings = config()
    without = settings.model_copy(update={"output": settings.output.model_copy(update={"images": False})})
    assert synchronized_topics(settings, rig()) == IN_USE
    assert synchronized_topics(without, rig()) == (FRONT, REAR)


def test_a_lidar_without_points_is_warned_of() -> None:
    messages = [message(m.topic, m.stamp_ns, m.log_time_ns, points=3 * (m.topic != REAR)) for m in periodic()]
    report, _ = run(messages, config())
    assert subjects(report) == ["rear", "no objects"]
    assert "warning: rear: 6 messages without a single point in range; the lidar may be" in printed(report)


def test_a_lidar_with_a_clock_of_its_own_is_warned_of() -> None:
    """Frames are of its time, and no other sensor is in them: the clock is the cause, not the queues."""
    ahead = [m._replace(stamp_ns=m.stamp_ns + 3600 * 10**9) if m.topic == REAR else m for m in periodic(count=20)]
    summary, _ = run(ahead, config())
    of_sensors = [warning for warning in summary.warnings if warning.subject != "no objects"]
    assert [(warning.subject, "3600.0 s after" in warning.finding) for warning in of_sensors] == [("rear", True)]


def test_a_run_without_lidars_from_a_time_on_goes_on() -> None:
    messages = [m for m in periodic(count=20) if m.topic == IMAGES or m.stamp_ns < START_NS + 10 * STEP_NS]
    summary, frames = run(messages, config())
    assert summary.frames.count == 20
    assert all({*frame.bundle.messages} == {IMAGES} for frame in frames[10:])
    assert all(len(frame.combined.cloud) == 0 and not len(frame.fused.objects) for frame in frames[10:])
    assert [(m.sensor, m.frames, str(m)) for m in summary.sensors.missing] == [
        ("front", 10, "silent from 0.9 s to the end"),
        ("rear", 10, "silent from 0.9 s to the end"),
    ]
    assert subjects(summary) == ["front, rear", "no objects"]
    assert summary_tree(summary)["missing"][0] == {
        "sensor": "front",
        "topic": FRONT,
        "frames": 10,
        "of_frames": 20,
        "silences": ({"start_s": 0.9, "end_s": None, "frames": 10},),
    }


def test_a_sensor_that_is_in_some_frames_is_printed_without_a_warning() -> None:
    messages = [m for m in periodic(count=20) if m.topic != IMAGES or m.stamp_ns % (2 * STEP_NS) == 0]
    summary, _ = run(messages, config())
    assert re.search(r"missing from frames\nsensor +frames +when\ncam +10 +in 10 of 20 frames\n", printed(summary))
    assert subjects(summary) == ["no objects"]


@pytest.mark.parametrize(
    ("copied", "told"),
    [
        ({"/map": 1}, "copied     1 messages: /map"),
        ({"/gt/a": 3, "/map": 1, "/gt/b/c": 2}, "copied     6 messages: /gt/* (2 topics), /map"),
        (
            {f"/{n}": 2 for n in "abcdefghijk"},
            "copied     22 messages: /a, /b, /c, /d, /e, /f, /g, /h, /i, /j and 1 more",
        ),
    ],
)
def test_what_is_copied_is_told_in_a_line(copied: dict[str, int], told: str) -> None:
    report, _ = run(periodic(), config())
    assert told in printed(changed(report, inputs={"copied": copied})).splitlines()


def test_2d_boxes_that_begin_no_object_are_told_by_reason() -> None:
    report, frames = run(periodic(), config())
    tally = Tally(config(), rig())
    for count in (2, 3):
        hypotheses = replace(frames[0].hypotheses, boxes_without_object={"too vague": count})
        tally.add(replace(frames[0], hypotheses=hypotheses))
    told = changed(report, drops={"boxes_without_object": tally.boxes_without_object})
    assert "  2D boxes without an object: 5, too vague" in printed(told).splitlines()
    assert summary_tree(told)["boxes_without_object"] == {"too vague": 5}
    assert summary_tree(report)["boxes_without_object"] == {}


def test_road_users_begin_the_tables_where_there_are_tracks() -> None:
    report, _ = run(periodic(), config().model_copy(update={"track": TrackConfig(mode="none")}))
    assert report.road_users is None
    assert summary_tree(report)["road_users"] is None
    counts = (RoadUserCount("car", "north", 2, 2.0, 4.0), RoadUserCount("car", "", 2, 2.5, 4.0))
    told = replace(report, road_users=RoadUsers(counts, (ZoneChange("car", "north", "south", 1, 6.0),)))
    begin, rest = printed(told).removesuffix(printed(report)), printed(report)
    assert printed(told) == begin + rest
    assert [line.split()[:2] for line in begin.splitlines() if line][::4] == [["road", "users"], ["road", "users"]]
    assert summary_tree(told)["road_users"] == {
        "counts": [
            {"class": "car", "zone": "north", "count": 2, "speed_mean_m_s": 2.0, "speed_max_m_s": 4.0},
            {"class": "car", "zone": None, "count": 2, "speed_mean_m_s": 2.5, "speed_max_m_s": 4.0},
        ],
        "changes": [{"class": "car", "from_zone": "north", "to_zone": "south", "count": 1, "speed_mean_m_s": 6.0}],
    }


def test_the_first_required_topic_is_the_reference() -> None:
    messages = [*periodic((IMAGES,)), message(FRONT, START_NS + STEP_NS // 5, START_NS + STEP_NS // 5)]
    _, frames = run(messages, config(required=[IMAGES]))
    assert [frame.bundle.stamp_ns for frame in frames] == [START_NS + k * STEP_NS for k in range(6)]
    assert [FRONT in frame.bundle.messages for frame in frames] == [True] + 5 * [False]


def moved(whole: RawMessage, later_s: float) -> RawMessage:
    """The message recorded at another time, with the stamp as it is."""
    return whole._replace(log_time_ns=whole.log_time_ns + round(later_s * 1e9))


def test_a_loop_that_was_recorded_is_split_and_no_frame_mixes_both_sides() -> None:
    once = periodic((ODOMETRY, *IN_USE), count=30)
    messages = [*once, *(moved(m, 3) for m in once)]
    source = MotionSource((ODOMETRY,), "base_link", "odom", ("base_link",))
    summary, frames = run(messages, config(), motion=source)
    assert [frame.bundle.index for frame in frames] == [*range(60)]
    assert [(frame.bundle.stamp_ns - START_NS) // STEP_NS for frame in frames] == [*range(30)] * 2
    for frame in frames:
        assert {m.stamp_ns for m in frame.bundle.messages.values()} == {frame.bundle.stamp_ns}
        (log_time_ns,) = {m.log_time_ns for m in frame.bundle.messages.values()}
        assert (log_time_ns >= START_NS + 3 * 10**9) == (frame.bundle.index >= 30)
    assert frames[30].bundle.motion is not None
    assert frames[30].bundle.motion.stamps_ns[0] == START_NS  # nothing of the turn before
    assert [str(warning) for warning in summary.warnings if warning.subject == "time"] == [
        "time: stamps jump back by 3.0 s at 3.0 s: no frame has messages of both sides; "
        "if it was played in a loop, take one turn of it with --start and --duration"
    ]
    assert not summary.drops.messages


def test_impossible_stamps_cost_only_their_messages() -> None:
    messages = periodic(count=30)
    for place, stamp_ns in ((31, 0), (45, START_NS + 10**15), (62, START_NS - 10**15)):  # one of each sensor
        messages[place] = message(messages[place].topic, stamp_ns, messages[place].log_time_ns)
    summary, frames = run(messages, config())
    assert len(frames) == 28
    assert {key: count for key, count in drop_counts(summary).items() if "stamp" in key[1]} == {
        (REAR, "its stamp is 0"): 1,
        (FRONT, "its stamp is far from those around it"): 1,
        (IMAGES, "its stamp is far from those around it"): 1,
    }
    assert "time" not in subjects(summary)


def test_a_camera_that_never_sets_its_stamps_takes_part_by_log_time() -> None:
    messages = [m if m.topic != IMAGES else message(IMAGES, 0, m.log_time_ns) for m in periodic(count=10)]
    summary, frames = run(messages, config())
    assert len(frames) == 10
    assert all(IMAGES in frame.bundle.messages for frame in frames)
    assert summary.notes == ("cam: all stamps are 0, so the times at which the messages were recorded are used",)
    assert not summary.sensors.missing


def test_time_offsets_of_the_rig_are_taken_off_before_synchronisation() -> None:
    messages = [
        message(m.topic, m.stamp_ns + (80_000_000 if m.topic == IMAGES else 0), m.log_time_ns + 90_000_000)
        for m in periodic(count=10)
    ]
    _, frames = run(messages, config(), sensors=rig(image_offset_ns=80_000_000))
    assert {frame.bundle.skew_ns for frame in frames} == {0}
    assert len(frames) == 10


def test_a_camera_that_falls_silent_in_one_part_and_is_back_in_the_next_is_silent_until_then() -> None:
    once = periodic(count=30)
    ends_early = [m for m in once if m.topic != IMAGES or m.stamp_ns < START_NS + 20 * STEP_NS]
    summary, _ = run([*ends_early, *(moved(m, 3) for m in once)], config())
    assert [str(sensor) for sensor in summary.sensors.missing] == ["silent from 1.9 s to 3.0 s"]
    summary, _ = run([*ends_early, *(moved(m, 3) for m in ends_early)], config())
    assert [str(sensor) for sensor in summary.sensors.missing] == [
        "silent from 1.9 s to 3.0 s, silent from 4.9 s to the end"
    ]


def test_a_sensor_recorded_too_late_to_be_waited_for_is_told() -> None:
    messages = [moved(m, 2) if m.topic == IMAGES else m for m in periodic(count=60)]
    summary, frames = run(messages, config())
    assert len([frame for frame in frames if FRONT in frame.bundle.messages]) == 60
    (warning,) = (one for one in summary.warnings if "complete" in one.finding)
    assert warning.subject == "cam"
    assert "of 60 messages came after their frames were complete" in warning.finding
    patient, _ = run(messages, config(queue_size=30))
    assert patient.inputs.messages_used[IMAGES] > 35
