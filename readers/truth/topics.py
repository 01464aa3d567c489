"""Topics of truth in a recording."""

import re
from collections.abc import Collection
from typing import NamedTuple

from lidcam.pipeline.core.errors import ConfigError
from lidcam.readers.messages.detections import DETECTIONS_2D, DETECTIONS_3D
from lidcam.readers.recording import Recording
from lidcam.readers.rig.topic_names import is_truth

WHEN_MEASURED = "_when_measured"
"""End of the name of the topic that has the same objects where the lidars measured them."""


class TruthTopics(NamedTuple):
    """The topics of one truth."""

    objects: str  # Objects at their stamp
    when_measured: str  # The same objects where the lidars measured them; empty if that was not recorded
    visible: tuple[str, ...]  # Boxes of what each image shows: one topic for each camera
    why: str  # Why this is the truth, for the user


def find_truth_topics(
    recording: Recording, results: Collection[str], wanted: str = "", *, sources: Collection[str] = ()
) -> TruthTopics | str:
    """The topics of the truth, or why there is none.

    Truth is what is called so (see `is_truth`), of several topics that with the most messages, then the first by name;
    else the only topic of 3D boxes that is no result. What images show lies beside the objects:
    `/ground_truth/CAMERA/visible`.

    `results` are topics that are no truth, `sources` those of boxes that the result was made from: truth only by their
    name. `wanted` is the topic to take, by any name; raises ConfigError if there is no such topic of 3D boxes.
    """
    infos = {
        info.topic: info
        for info in recording.topics
        if info.msgtype == DETECTIONS_3D and info.message_count and not info.unreadable
    }
    others = sorted(topic for topic in infos if topic not in results and not topic.endswith(WHEN_MEASURED))
    names = ", ".join(map(str, recording.paths))
    if wanted:
        if wanted not in infos:
            raise ConfigError(
                f"truth_topic: expected a topic of {DETECTIONS_3D} in {names} ({', '.join(others) or 'it has none'})"
                f", found {wanted!r}"
            )
        chosen, why = wanted, "as asked for"
    elif named := [topic for topic in others if is_truth(topic, DETECTIONS_3D)]:
        chosen = min(named, key=lambda topic: (-infos[topic].message_count, topic))
        more = [topic for topic in named if topic != chosen]
        why = f"by its name; --truth-topic takes another one ({', '.join(more)})" if more else "by its name"
    elif len(unused := [topic for topic in others if topic not in sources]) == 1:
        chosen, why = unused[0], "the only 3D boxes that are no result"
    elif unused:
        return f"{names}: {', '.join(unused)} may be truth, none is called so: name one with --truth-topic"
    else:
        return (
            f"{names}: expected truth, a topic of {DETECTIONS_3D} that is no result, or odometry of vehicles that the "
            "rig calls truth, found none"
        )
    folder = re.escape(chosen.rsplit("/", 1)[0])
    images = [info for info in recording.topics if info.msgtype == DETECTIONS_2D and info.message_count]
    return TruthTopics(
        chosen,
        chosen + WHEN_MEASURED if chosen + WHEN_MEASURED in infos else "",
        tuple(info.topic for info in images if re.fullmatch(f"{folder}/[^/]+/visible", info.topic)),
        why,
    )
