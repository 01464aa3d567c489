from itertools import islice
from pathlib import Path

import pytest
from builders import in_order, write_rosbag1
from command import Lidcam, Run, called
from helpers import CLUSTERS, SANDBOX
from results import fused_objects

from lidcam.pipeline.core.messages import RawMessage
from lidcam.readers.open import open_recording

FRAMES = 6
"""Messages of each sensor in `first_messages`."""


@pytest.fixture(scope="session")
def lidcam(tmp_path_factory: pytest.TempPathFactory) -> Lidcam:
    """Call `lidcam ...` in this process, from another folder, with arguments of any type that has a text form.

    `test_calling` and `test_wheel` start the installed program.
    """
    elsewhere = tmp_path_factory.mktemp("elsewhere")

    def call(*arguments: object, folder: Path = elsewhere) -> Run:
        return called(folder, *arguments)

    return call


@pytest.fixture(scope="session")
def first_messages() -> dict[str, list[RawMessage]]:
    """The first messages of the sample by topic, as many of each sensor; without truth of the cars."""
    with open_recording([SANDBOX]) as recording:
        topics = [info.topic for info in recording.topics if "base_pose" not in info.topic]
        return {topic: [*islice(recording.messages([topic]), FRAMES)] for topic in topics}


@pytest.fixture(scope="session")
def first_result(
    first_messages: dict[str, list[RawMessage]], lidcam: Lidcam, tmp_path_factory: pytest.TempPathFactory
) -> Path:
    """What they become with the sample's settings, by clusters."""
    path = tmp_path_factory.mktemp("first") / "first.bag"
    write_rosbag1(path, in_order(*first_messages.values()))
    run = lidcam("process", path, path.with_name("out.mcap"), "--config", "sandbox", "--set", CLUSTERS)
    assert run.code == 0, run.err
    assert sum(map(len, fused_objects(path.with_name("out.mcap")).values())) >= 8
    return path.with_name("out.mcap")
