import re
from collections.abc import Collection

import pytest
from builders import raw
from memory_recording import MemoryRecording
from truth_messages import true_object, truth_message, visible_message

from lidcam.pipeline.core.errors import ConfigError
from lidcam.readers.results.result import RESULT_TOPICS
from lidcam.readers.truth.topics import TruthTopics, find_truth_topics

CAR = [true_object("car", (0, 0, 0))]


def recording(*topics: str, counts: dict[str, int] | None = None) -> MemoryRecording:
    counts = counts or {}
    messages = [truth_message(n, CAR, topic=topic) for topic in topics for n in range(counts.get(topic, 1))]
    return MemoryRecording([*messages, visible_message(0, []), raw("/other", "std_msgs/msg/String", {}, 0)])


def chosen(*topics: str, wanted: str = "", **options: dict[str, int]) -> TruthTopics:
    found = find_truth_topics(recording(*topics, **options), RESULT_TOPICS, wanted)
    assert isinstance(found, TruthTopics)
    return found


@pytest.mark.parametrize(
    ("topics", "objects", "why"),
    [
        (["/ground_truth/objects"], "/ground_truth/objects", "by its name"),
        (["/gt", "/perception/objects"], "/gt", "by its name"),
        (["/my_annotations/boxes", "/lidar/detections"], "/my_annotations/boxes", "by its name"),
        (["/perception/objects", "/fused/detections", "/lidar/detections"], "/perception/objects", "the only 3D boxes"),
        (["/ground_truth/objects", "/ground_truth/objects_when_measured"], "/ground_truth/objects", "by its name"),
    ],
)
def test_truth_is_told_by_its_name(topics: list[str], objects: str, why: str) -> None:
    found = chosen(*topics)
    assert found.objects == objects
    assert found.why.startswith(why)


def test_of_several_the_one_with_the_most_messages() -> None:
    found = chosen("/a/truth", "/b/truth", "/c/truth", counts={"/b/truth": 3, "/c/truth": 3})
    assert found.objects == "/b/truth"
    assert found.why == "by its name; --truth-topic takes another one (/a/truth, /c/truth)"


def test_a_topic_that_is_asked_for() -> None:
    assert chosen("/ground_truth/objects", "/other/objects", wanted="/other/objects").objects == "/other/objects"
    assert chosen("/ground_truth/objects", "/fused/detections", wanted="/fused/detections").why == "as asked for"
    expected = "truth_topic: expected a topic of vision_msgs/msg/Detection3DArray in  (/gt/a), found '/gt/b'"
    with pytest.raises(ConfigError, match=re.escape(expected)):
        chosen("/gt/a", wanted="/gt/b")
    with pytest.raises(ConfigError, match="it has none"):
        chosen(wanted="/other")


@pytest.mark.parametrize(
    ("topics", "results", "sources", "expected"),
    [
        ([], RESULT_TOPICS, [], "a topic of vision_msgs/msg/Detection3DArray that is no result, or odometry"),
        (["/fused/detections", "/lidar/detections", "/cameras/detections"], RESULT_TOPICS, [], "found none"),
        (["/a/objects", "/b/objects"], RESULT_TOPICS, [], "/a/objects, /b/objects may be truth, none is called so: na"),
        (["/fused/detections"], (), [], "/fused/detections"),  # of another program
        (["/detector/objects"], RESULT_TOPICS, ["/detector/objects"], "found none"),
        (["/detector/objects", "/labels"], RESULT_TOPICS, ["/detector/objects"], "/labels"),
        (["/ground_truth/a"], RESULT_TOPICS, ["/ground_truth/a"], "/ground_truth/a"),
    ],
)
def test_boxes_of_results_and_their_sources(
    topics: list[str], results: Collection[str], sources: list[str], expected: str
) -> None:
    found = find_truth_topics(recording(*topics), results, sources=sources)
    assert expected in (found if isinstance(found, str) else [found.objects])
