from collections.abc import Sequence

import numpy as np
import pytest
from builders import Encoding
from detections import forward_camera
from memory_recording import MemoryRecording
from truth_messages import true_object, truth_message, visible_message

from lidcam.pipeline.core.messages import RawMessage
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.core.settings.load import load_config
from lidcam.pipeline.evaluation.evaluation_frame import UNKNOWN
from lidcam.readers.messages.detections import track_ids
from lidcam.readers.truth.recorded import RecordedTruth
from lidcam.readers.truth.topics import TruthTopics, find_truth_topics

S = 10**9
STEP_NS = 100_000_000
START_NS = 1_700_000_000 * S
POINTS = load_config(settings=["evaluate.truth_time=points"])


def messages(
    frames: int = 30, *, start_ns: int = START_NS, encoding: Encoding = "cdr", name: str = "1", topic: str = "objects"
) -> list[RawMessage]:
    """A car that drives 10 m/s along x, recorded a second late."""
    found = []
    for number in range(frames):
        stamp_ns = start_ns + number * STEP_NS
        car = true_object("car", (number, 0, 0), name=name, counts={"lidar_points": number})
        found.append(
            truth_message(stamp_ns, [car], topic=f"/ground_truth/{topic}", log_time_ns=stamp_ns + S, encoding=encoding)
        )
    return found


def truth(raws: Sequence[RawMessage], config: Config | None = None) -> RecordedTruth:
    recording = MemoryRecording(raws)
    topics = find_truth_topics(recording, ())
    assert isinstance(topics, TruthTopics)
    return RecordedTruth(recording, topics, [forward_camera("left"), forward_camera("right")], config or Config())


def x_at(source: RecordedTruth, stamp_ns: int) -> float | None:
    boxes = source.at(stamp_ns, frame=0)
    return None if boxes is None else float(boxes.centers[0, 0])


@pytest.mark.parametrize("encoding", ["ros1", "cdr"])
def test_objects_at_any_time(encoding: Encoding) -> None:
    source = truth(messages(encoding=encoding))
    for step in (0, 0.25, 7, 12.5, 11, 29, 29.05):
        assert x_at(source, START_NS + round(step * STEP_NS)) == pytest.approx(step)
    assert x_at(source, START_NS + 30 * STEP_NS) is None
    assert source.notes == ()
    back = truth(messages(encoding=encoding))
    for step in (-1, 0, 25, 6):  # images of a frame lie before it
        assert x_at(back, START_NS + step * STEP_NS) == (None if step < 0 else pytest.approx(step))
    assert source.description == "/ground_truth/objects of  (by its name)"


def test_memory_does_not_grow_with_the_truth() -> None:
    source = truth(messages(1000))
    assert x_at(source, START_NS + 900 * STEP_NS) == pytest.approx(900)
    (timeline,) = source._timelines.values()
    assert len(timeline._kept) < 30


def test_where_objects_were_when_they_were_measured() -> None:
    late = [
        truth_message(
            START_NS + n * STEP_NS,
            [true_object("car", (n + 0.5, 0, 0), name="1")],
            topic="/ground_truth/objects_when_measured",
            log_time_ns=START_NS + n * STEP_NS + S,
        )
        for n in range(20)
    ]
    both = [*messages(20), *late]
    assert x_at(truth(both), START_NS + 4 * STEP_NS) == 4
    source = truth(both, POINTS)
    assert x_at(source, START_NS + 4 * STEP_NS) == 4.5
    moment = source.moment(START_NS + 4 * STEP_NS, frame=0)
    assert moment is not None
    assert moment.boxes.centers[0, 0] == 4  # an image shows where it is at the image's own time
    assert source.description.startswith("/ground_truth/objects_when_measured of")
    assert source.notes == ()
    alone = truth(messages(20), POINTS)
    assert x_at(alone, START_NS + 4 * STEP_NS) == 4
    assert alone.notes == (
        "no /ground_truth/objects_when_measured was recorded: compared at the stamp of each frame: 1",
    )


def shown(number: int, *, stamp_ns: int = 0, log_s: float = 1.5) -> RawMessage:
    stamp_ns = stamp_ns or START_NS + number * STEP_NS
    boxes = [("van", (10, 20, 30, 40 + number), "van_1", 99.0), ("tram", (0, 0, 5, 5), "", 3.0)]
    return visible_message(stamp_ns, boxes, log_time_ns=stamp_ns + round(log_s * S))


def test_what_images_show() -> None:
    source = truth([*messages(), *(shown(number) for number in range(30))])
    for number in (0, 3, 2, 25):
        found = source.in_image("left", START_NS + number * STEP_NS, frame=0)
        assert found is not None
        assert found.stamp_ns == START_NS + number * STEP_NS
        assert found.xyxy.tolist() == [[10, 20, 30, 40 + number], [0, 0, 5, 5]]
        assert [Config().class_names[row] if row >= 0 else "" for row in found.class_ids] == ["truck", ""]
        assert found.labels.tolist() == ["van", "tram"]
        assert found.track_ids.tolist() == [int(track_ids(np.array(["van_1"]))[0]), UNKNOWN]
        assert found.image_pixels.tolist() == [99, 3]
    near = source.in_image("left", START_NS + 25 * STEP_NS + 15_000_000, frame=0)
    assert near is not None
    assert near.xyxy[0, 3] == 65
    assert source.in_image("left", START_NS + 25 * STEP_NS + 50_000_000, frame=0) is None
    assert source.in_image("right", START_NS, frame=0) is None


def test_cameras_are_told_by_their_frames_then_by_their_names() -> None:
    """The scenario may call a camera otherwise than the result does, where it is called after its topic."""
    raws = [
        visible_message(START_NS, [("car", (0, 0, 9, 9), "", 1.0)], camera=name, frame_id=frame_id)
        for name, frame_id in (("front", "left"), ("right", "elsewhere"), ("rear", "rear_optical"))
    ]
    source = truth([*messages(), *raws])
    assert source.in_image("left", START_NS, frame=0) is not None
    assert source.in_image("right", START_NS, frame=0) is not None
    assert source.notes == ("images of /ground_truth/rear/visible, a camera that the result does not have: 1",)


def test_images_do_not_fill_the_memory() -> None:
    many = [shown(0, stamp_ns=START_NS + 5 * S + number * 1000, log_s=-4) for number in range(1500)]
    source = truth([*messages(100), *many])
    assert x_at(source, START_NS) == 0
    assert len(source._images["left"]._kept) <= 1000


def test_messages_and_objects_that_cannot_be_used() -> None:
    raws = messages()
    raws[3] = raws[3]._replace(data=bytes(raws[3].data)[:50])
    flat = true_object("car", (0, 0, 0), size=(1, 1, 0), name="2")
    tram = true_object("tram", (5, 5, 5), name="3")
    raws += [truth_message(START_NS + 30 * STEP_NS, [flat, tram], log_time_ns=START_NS + 99 * S)]
    source = truth([*raws, shown(5)._replace(data=b"\0\1\0\0")])
    assert x_at(source, START_NS + 3 * STEP_NS) == pytest.approx(3)  # between the messages around it
    assert x_at(source, START_NS + 30 * STEP_NS) == 5
    notes = source.notes
    assert len(notes) == 4
    assert notes[0].startswith("messages of /ground_truth/objects that are not used: 1, the first: /ground_truth/obj")
    assert notes[1].startswith("messages of /ground_truth/left/visible that are not used: 1, the first: ")
    assert notes[2:] == (
        "/ground_truth/objects: objects that are not used, box without a volume or not finite: 1",
        "/ground_truth/objects: objects of class 'tram', which is no class of the settings: 1",
    )
