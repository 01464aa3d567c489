"""A run's bookkeeping: every message of a topic in use ends in a set or in the drop table."""

from collections import Counter
from collections.abc import Sequence

import numpy as np
import pytest
from builders import image, odometry, pointcloud2, raw
from hypothesis import given, settings
from hypothesis import strategies as st
from memory_recording import MemoryRecording

from lidcam.pipeline.core.camera import CameraModel
from lidcam.pipeline.core.errors import ConfigError, RecordingError
from lidcam.pipeline.core.frame import FrameResult
from lidcam.pipeline.core.geometry.transform import Transform
from lidcam.pipeline.core.geometry.transform_tree import TransformTree
from lidcam.pipeline.core.messages import RawMessage
from lidcam.pipeline.core.rig import CameraSensor, LidarSensor, Rig
from lidcam.pipeline.core.settings.config import Config
from lidcam.processing import Run
from lidcam.readers.messages.tf import RecordedTransforms
from lidcam.readers.rig.discovery import Discovery
from lidcam.readers.streams.motion import MotionSource
from lidcam.run.frames import RunInput, TimeWindow
from lidcam.run.summary import RunSummary
from lidcam.run.tally import DropTable

STEP_NS = 100_000_000
START_NS = 1_600_000_000_000_000_000
FRONT, REAR, IMAGES, ODOMETRY = "/front/points", "/rear/points", "/cam/image_raw", "/odom"
IN_USE = (FRONT, REAR, IMAGES)


def config(**sync: object) -> Config:
    return Config.model_validate({"sync": sync, "detect3d": {"method": "none"}, "run": {"workers": 1}})


def rig() -> Rig:
    model = CameraModel("cam", 8, 6, np.array([[8.0, 0, 4], [0, 8, 3], [0, 0, 1]]), "plumb_bob", np.zeros(0))
    lidars = tuple(
        LidarSensor(name, f"/{name}/points", Transform.identity("base_link", name)) for name in ("front", "rear")
    )
    camera = CameraSensor("cam", IMAGES, "", model, Transform.identity("cam", "base_link"))
    return Rig("base_link", lidars, (camera,), ())


def message(topic: str, stamp_ns: int, log_time_ns: int) -> RawMessage:
    if topic == IMAGES:
        pixels = np.zeros((6, 8, 3), np.uint8)
        return raw(topic, "sensor_msgs/msg/Image", image(pixels, stamp_ns=stamp_ns), stamp_ns, log_time_ns)
    if topic == ODOMETRY:
        pose = odometry(stamp_ns=stamp_ns, position=((stamp_ns - START_NS) / 1e9, 0, 0))
        return raw(topic, "nav_msgs/msg/Odometry", pose, stamp_ns, log_time_ns)
    xyz = np.full((3, 3), 1.0 + (stamp_ns - START_NS) / 1e12, np.float32)  # the rig moves: no two clouds are equal
    cloud = pointcloud2(xyz, stamp_ns=stamp_ns, frame_id=topic.split("/")[1])
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
) -> tuple[RunSummary, list[FrameResult]]:
    source = RunInput(MemoryRecording(messages), rig(), settings, motion, window or TimeWindow())
    pass_over = Run(source, Discovery(source.rig, (), (), (), RecordedTransforms(TransformTree())), DropTable())
    frames: list[FrameResult] = [*pass_over.frames([])]
    return pass_over.summary(), frames


def assert_all_accounted_for(summary: RunSummary, messages: Sequence[RawMessage], topics: Sequence[str]) -> None:
    recorded = Counter(m.topic for m in messages if m.topic in topics)
    dropped: Counter[str] = Counter()
    for drop in summary.drops.messages:
        dropped[drop.topic] += drop.count
    assert {t: summary.inputs.messages_used.get(t, 0) + dropped[t] for t in recorded} == dict(recorded)


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
def test_every_message_is_used_or_dropped(recorded: list[tuple[str, int, int, bool]], queue_size: int) -> None:
    messages = periodic(count=2)
    for topic, at, late, is_bad in recorded:
        stamp_ns = START_NS + at * 10_000_000
        whole = message(topic, stamp_ns, stamp_ns + late * 10_000_000)
        messages.append(broken(whole) if is_bad else whole)
    try:
        summary, frames = run(messages, config(queue_size=queue_size))
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
    (drop,) = summary.drops.messages
    assert (drop.topic, drop.reason, drop.count) == (ODOMETRY, "cannot be decoded", 1)
    assert all(frame.bundle.motion is not None for frame in frames[1:])
    assert all(ODOMETRY not in frame.bundle.messages for frame in frames)


def test_a_window_counts_only_what_was_recorded_in_it() -> None:
    messages = periodic()
    window = TimeWindow(START_NS + STEP_NS, START_NS + 4 * STEP_NS)
    summary, frames = run(messages, config(), window=window)
    inside = [m for m in messages if START_NS + STEP_NS <= m.log_time_ns < START_NS + 4 * STEP_NS]
    assert [frame.bundle.stamp_ns for frame in frames] == [START_NS + k * STEP_NS for k in (1, 2, 3)]
    assert_all_accounted_for(summary, inside, IN_USE)


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
    ],
)
def test_the_reference_and_required_topics_have_to_be_in_use(sync: dict[str, object], fault: str) -> None:
    with pytest.raises(ConfigError, match=fault):
        run(periodic(), config(**sync))


def test_a_loop_that_was_recorded_is_split_and_no_frame_mixes_both_sides() -> None:
    once = periodic((ODOMETRY, *IN_USE), count=30)
    messages = [*once, *(m._replace(log_time_ns=m.log_time_ns + 3 * 10**9) for m in once)]
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
        "if it was played in a loop, process one pass of it with --duration 3, or --start 3"
    ]
    assert not summary.drops.messages


@pytest.mark.parametrize(
    ("period_s", "apart_s", "limit", "frames"),
    [
        (0.2, 0.1, "auto", 5),
        (0.2, 0.1, 0.1, 5),
        (0.21, 0.105, "auto", 5),
        (0.21, 0.105, 0.1, 0),
        (0.5, 0.25, "auto", 5),
        (1.0, 0.45, "auto", 0),
        (0.1, 0.04, "auto", 5),
    ],
)
def test_slow_lidars_need_not_measure_at_one_time(period_s: float, apart_s: float, limit: object, frames: int) -> None:
    times = [
        (topic, round((k * period_s + offset) * 1e9))
        for k in range(6)
        for topic, offset in ((FRONT, 0), (REAR, apart_s))
    ]
    messages = [message(topic, START_NS + ns, START_NS + ns) for topic, ns in times]
    try:
        _, found = run(messages, config(max_interval_s=limit, silent_after_s=3.0))
    except RecordingError:
        found = []
    assert len(found) >= frames if frames else not found
