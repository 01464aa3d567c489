"""A recording of all topics of a robot gives the objects that the sensors' topics, named by hand, give."""

from dataclasses import replace
from pathlib import Path

from builders import in_order, write_rosbag1
from command import Lidcam
from helpers import CLUSTERS
from results import fused_objects

from lidcam.pipeline.core.messages import RawMessage


def handed_on(messages: list[RawMessage], topic: str) -> list[RawMessage]:
    """What a node publishes 20 ms after it has received it."""
    return [
        message._replace(
            channel=replace(message.channel, topic=topic), log_time_ns=message.log_time_ns + 20_000_000, order=(1, row)
        )
        for row, message in enumerate(messages)
    ]


def test_the_same_objects_as_with_topics_named_by_hand(
    first_messages: dict[str, list[RawMessage]], lidcam: Lidcam, tmp_path: Path
) -> None:
    lidars = [topic for topic in first_messages if topic.endswith("_points")]
    cameras = [topic for topic in first_messages if topic.startswith("/image_raw")]
    more = [handed_on(first_messages[topic], f"/nodes{topic}/output") for topic in lidars]
    more += [handed_on(first_messages[topic], f"/debug{topic}") for topic in cameras]
    write_rosbag1(tmp_path / "all.bag", in_order(*first_messages.values(), *more))
    common = "--config", "sandbox", "--set", CLUSTERS
    chosen = [f"topics.lidars=[{','.join(lidars)}]", f"topics.cameras=[{','.join(cameras)}]"]
    named = [word for one in chosen for word in ("--set", one)]
    found = lidcam("process", tmp_path / "all.bag", tmp_path / "found.mcap", *common, "-v")
    assert found.code == 0, found.err
    assert f"to choose others: --set '{chosen[0]}'" in " ".join(found.out.split())
    assert lidcam("process", tmp_path / "all.bag", tmp_path / "named.mcap", *common, *named).code == 0
    assert fused_objects(tmp_path / "found.mcap") == fused_objects(tmp_path / "named.mcap")
