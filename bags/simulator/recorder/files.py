"""Writes simulated recordings, ROS 1 bag or MCAP; the same messages give the same bytes."""

import contextlib
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any

from rosbags.rosbag1 import Writer as Rosbag1Writer

from lidcam.bags.simulator.recorder.recorded import Recorded
from lidcam.pipeline.core.errors import OutputError
from lidcam.pipeline.core.ros.qos import LATCHED_YAML_HUMBLE
from lidcam.pipeline.core.ros.typestores import RosVersion, message_types
from lidcam.writers.mcap.output import mcap_file
from lidcam.writers.outputs.errors import output_errors
from lidcam.writers.outputs.marks import BAG_CALLER, SIMULATED, marked_yaml
from lidcam.writers.outputs.transaction import OutputTransaction

WriteMessage = Callable[[Recorded, int], None]
"""Adds a message of a scenario that began at a time in ns since 1970; log times must not decrease."""

ROS_VERSIONS: Mapping[str, RosVersion] = {".bag": 1, ".mcap": 2}
"""By the ending of a recording's name."""

ATTACHMENTS = ("rig.yaml", "scenario.yaml")


def ros_version_of(path: Path) -> RosVersion:
    """The ROS version of a recording's messages, by its name; raises OutputError if `ROS_VERSIONS` lacks its ending."""
    if path.suffix not in ROS_VERSIONS:
        raise OutputError(f"{path}: expected a name that ends in .bag (ROS 1) or .mcap (ROS 2)")
    return ROS_VERSIONS[path.suffix]


def recording_names(path: Path) -> list[Path]:
    """The files of a recording: the recording itself, and what is written beside it."""
    return [path] if path.suffix == ".mcap" else [path, *(_beside(path, name) for name in ATTACHMENTS)]


@contextlib.contextmanager
def recording_file(
    outputs: OutputTransaction, path: Path, *, rig_yaml: str, scenario_yaml: str
) -> Iterator[WriteMessage]:
    """Write a recording, whose files are the outputs; it is complete when the block ends well.

    The true calibration and the scenario are attachments of an MCAP, else `NAME.rig.yaml` and `NAME.scenario.yaml`
    beside the bag.

    Raises:
        OutputError: it cannot be written.
    """
    texts = dict(zip(ATTACHMENTS, (rig_yaml, scenario_yaml), strict=True))
    part = outputs[path].part
    with output_errors(path):
        if path.suffix == ".mcap":
            with mcap_file(part, profile="ros2") as file:
                for name, text in texts.items():
                    file.attach(name, text)
                file.add_metadata(SIMULATED, {"attachments": ", ".join(texts)})
                yield _writer(
                    lambda one: file.add_ros2(one.topic, one.msgtype, LATCHED_YAML_HUMBLE if one.latched else None),
                    file.add_message,
                )
            return
        for name, text in texts.items():
            outputs[_beside(path, name)].write_text(marked_yaml(text))
        bag = Rosbag1Writer(part)
        bag.set_compression(Rosbag1Writer.CompressionFormat.LZ4)
        with bag:
            yield _writer(partial(_bag_connection, bag), bag.write)


def _beside(path: Path, name: str) -> Path:
    """A file beside a recording; its name begins with that of the recording."""
    return path.with_name(f"{path.name}.{name}")


def _bag_connection(bag: Rosbag1Writer, first: Recorded) -> Any:
    options: Any = {"latching": 1 if first.latched else None, "callerid": BAG_CALLER}
    return bag.add_connection(first.topic, first.msgtype, typestore=message_types(1), **options)


def _writer(connect: Callable[[Recorded], Any], write: Callable[[Any, int, bytes], None]) -> WriteMessage:
    """Writes messages; each topic is connected with its first one."""
    connections: dict[str, Any] = {}

    def write_one(recorded: Recorded, start_ns: int) -> None:
        if recorded.topic not in connections:
            connections[recorded.topic] = connect(recorded)
        write(connections[recorded.topic], start_ns + recorded.log_ns, recorded.data)

    return write_one
