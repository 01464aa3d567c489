from collections.abc import Sequence

from builders import odometry, raw
from hypothesis import given
from hypothesis import strategies as st
from memory_recording import MemoryRecording
from truth_messages import true_object, truth_message

from lidcam.pipeline.core.frame import SensorBundle
from lidcam.pipeline.core.messages import Drop, RawMessage
from lidcam.pipeline.core.settings.classes import ROAD_CLASSES
from lidcam.pipeline.core.settings.recording import RecordingLimits
from lidcam.readers.messages.deserialize import deserialize
from lidcam.readers.streams.copied import MARGIN_NS, MESSAGE_BYTES, CopiedMessages

SEC = 1_000_000_000
ODOM = "nav_msgs/msg/Odometry"


def message(topic: str, log_time_ns: int) -> RawMessage:
    return raw(topic, ODOM, odometry(stamp_ns=log_time_ns), log_time_ns)


def bundle(index: int, log_time_ns: int) -> SensorBundle:
    return SensorBundle(index, log_time_ns, log_time_ns, {})


def handed_on(copied: CopiedMessages, stream: Sequence[RawMessage], *, every: int = 1) -> list[SensorBundle]:
    """Bundles made of each `every`-th message of /sensor that the stream lets through."""
    passed = copied.tap(stream, {"/sensor"})
    bundles = (bundle(k // every, one.log_time_ns) for k, one in enumerate(passed) if k % every == every - 1)
    return list(copied.handed_on(bundles, MemoryRecording(stream), None))


def times(found: SensorBundle) -> list[int]:
    return [one.log_time_ns for one in found.copied]


def test_each_message_goes_with_the_first_frame_not_before_it() -> None:
    stream = [message(topic, at) for at in range(4) for topic in ("/truth", "/sensor")]
    stream += [message("/truth", 9), message("/other", 9)]
    found = handed_on(CopiedMessages(("/truth",)), stream)
    assert [times(one) for one in found] == [[0], [1], [2], [3, 9]]


def test_what_is_read_ahead_of_a_frame_waits_for_its_own() -> None:
    stream = [message(topic, at) for at in range(6) for topic in ("/truth", "/sensor")]
    copied = CopiedMessages(("/truth",))
    read = list(copied.tap(stream, {"/sensor"}))  # synchronisation may read far ahead
    bundles = [bundle(k, one.log_time_ns) for k, one in enumerate(read)]
    found = list(copied.handed_on(bundles, MemoryRecording(stream), None))
    assert [times(one) for one in found] == [[at] for at in range(6)]


def test_where_the_recorders_time_jumps_back_nothing_waits_for_the_old_time() -> None:
    stream = [message(topic, at) for at in (7, 8, 9, 1, 2, 3) for topic in ("/truth", "/sensor")]
    copied = CopiedMessages(("/truth",))
    bundles = (bundle(k, one.log_time_ns) for k, one in enumerate(copied.tap(stream, {"/sensor"})))
    found = list(copied.handed_on(bundles, MemoryRecording([]), None))
    assert [times(one) for one in found] == [[7], [8], [9], [1], [2], [3]]
    late = CopiedMessages(("/truth",))
    read = list(late.tap(stream, {"/sensor"}))
    after = [bundle(0, read[-2].log_time_ns)]
    assert times(next(late.handed_on(after, MemoryRecording([]), None))) == [7, 8, 9, 1, 2, 3]


def test_the_ends_of_a_window_have_a_margin() -> None:
    stream = [message("/truth", at) for at in range(0, 20 * SEC, SEC // 2)]
    recording = MemoryRecording(stream)
    copied = CopiedMessages(("/truth",))
    start_ns, stop_ns = 8 * SEC, 10 * SEC
    copied.read_ahead(recording, start_ns)
    inside = list(copied.tap(recording.messages(start_ns=start_ns, stop_ns=stop_ns), ()))
    assert inside == []
    (found,) = copied.handed_on([bundle(0, 9 * SEC)], recording, stop_ns)
    assert times(found) == list(range(start_ns - MARGIN_NS, stop_ns + MARGIN_NS, SEC // 2))


def test_what_cannot_be_converted_is_dropped() -> None:
    bad: list[Drop] = []
    copied = CopiedMessages(("/truth",), on_bad=bad.append)
    broken = message("/truth", 5)._replace(problem="its chunk is damaged", data=b"")
    stream = [broken, message("/sensor", 6)]
    (found,) = handed_on(copied, stream)
    assert found.copied == ()
    assert bad == [Drop("/truth", 5, "cannot be copied", "/truth: its chunk is damaged")]


def test_what_waits_is_limited_and_room_is_made_again() -> None:
    drops: list[Drop] = []
    one = message("/truth", 0)
    big = one._replace(data=bytes(one.data) + bytes((1 << 19) - len(one.data) - MESSAGE_BYTES))
    copied = CopiedMessages(("/truth",), limits=RecordingLimits(max_waiting_bytes=1 << 20), on_drop=drops.append)
    stream = [big._replace(log_time_ns=at) for at in (0, 1, 2)] + [message("/sensor", 3)]
    stream += [big._replace(log_time_ns=at) for at in (4, 5)] + [message("/sensor", 6)]
    found = handed_on(copied, stream)
    assert [times(one) for one in found] == [[0, 1], [4, 5]]
    assert [drop.reason for drop in drops] == ["more than limit_scale allows waited for a frame"]


@given(st.lists(st.tuples(st.sampled_from(["/truth", "/sensor"]), st.integers(0, 50)), max_size=30), st.integers(1, 4))
def test_all_messages_arrive_once_and_in_order(recorded: list[tuple[str, int]], every: int) -> None:
    stream = [message(topic, at) for topic, at in recorded]
    found = handed_on(CopiedMessages(("/truth",)), stream, every=every)
    copied = [one for frame in found for one in frame.copied]
    assert copied == ([one for one in stream if one.topic == "/truth"] if found else [])


def test_truth_is_drawn_if_it_can_be_read_and_its_numbers_get_names() -> None:
    whole, other = (
        truth_message(0, [true_object("car", (1, 2, 3))], topic=topic, encoding="ros1")
        for topic in ("/truth", "/other")
    )
    stream = [whole, other, whole._replace(data=bytes(whole.data)[:20]), whole._replace(stamp_ns=-1)]
    copied = CopiedMessages(("/truth", "/other"), ROAD_CLASSES, drawn=("/truth",))
    (found,) = handed_on(copied, [*stream, message("/sensor", 1)])
    assert [deserialize(one).detections[0].results[0].hypothesis.class_id for one in found.copied] == ["car"] * 3
    (drawn,) = found.truth
    assert (drawn.topic, drawn.stamp_ns, drawn.log_time_ns, list(drawn.labels)) == ("/truth", 0, 0, ["car"])
    assert drawn.sizes.tolist() == [[4, 2, 1.5]]
