"""Writes simulated recordings: ROS 1 bag, ROS 2 sqlite3 folder, MCAP.

The same messages give the same bytes.
"""

import contextlib
import sqlite3
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Literal

from rosbags.rosbag1 import Writer as Rosbag1Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Rosbag2Writer

from lidcam.bags.simulator.recorder.recorded import Recorded
from lidcam.pipeline.core.errors import OutputError
from lidcam.pipeline.core.ros.qos import LATCHED, LATCHED_YAML_HUMBLE
from lidcam.pipeline.core.ros.typestores import RosVersion, message_types
from lidcam.writers.mcap.output import McapOutput, mcap_file
from lidcam.writers.outputs.errors import output_errors
from lidcam.writers.outputs.marks import BAG_CALLER, FOLDER_DATA, SIMULATED, marked_yaml
from lidcam.writers.outputs.transaction import OutputTransaction

RecordingFormat = Literal["ros1", "sqlite3", "mcap"]
WriteMessage = Callable[[Recorded, int], None]
"""Adds a message of a scenario that began at a time in ns since 1970; log times must not decrease."""

FORMATS: tuple[RecordingFormat, ...] = ("ros1", "sqlite3", "mcap")

ENDINGS = "a name that ends in .bag (ROS 1), in .mcap (MCAP), or has no ending (ROS 2 sqlite3 folder), or a --format"
ATTACHMENTS = ("rig.yaml", "scenario.yaml")
METADATA_VERSION: Literal[8] = 8  # the newest that Humble reads


def format_of(path: Path, wanted: RecordingFormat | None) -> RecordingFormat:
    """The wanted format, else the one that the file name implies.

    Raises:
        OutputError: the name implies no format, or not the wanted one.
    """
    suffixes: dict[str, RecordingFormat] = {".bag": "ros1", ".mcap": "mcap", "": "sqlite3"}
    by_name = suffixes.get(path.suffix)
    if wanted is not None and (not path.suffix or by_name in (None, wanted)):
        return wanted
    if by_name is None or wanted is not None:
        asked = f"a name whose ending fits --format {wanted}" if wanted else ENDINGS
        raise OutputError(f"{path}: expected {asked}")
    return by_name


def ros_version_of(format: RecordingFormat) -> RosVersion:
    """The ROS version of a format's messages."""
    return 1 if format == "ros1" else 2


def recording_names(path: Path, format: RecordingFormat) -> list[Path]:
    """The files of a recording: the recording itself, and what is written beside it."""
    return [path] if format == "mcap" else [path, *(_beside(path, name) for name in ATTACHMENTS)]


def recording_outputs(
    path: Path, format: RecordingFormat, *, check_old: Callable[[Path], None] = lambda _: None
) -> OutputTransaction:
    """The files of a recording, to be locked before it begins.

    `check_old` is called with an existing file or folder that is to be replaced, as by `OutputTransaction`. A folder
    with anything else than a ROS 2 recording is refused in any case.
    """

    def check(old: Path) -> None:
        if old == path and format == "sqlite3":
            files = list(path.iterdir())
            is_known = all(file.name == "metadata.yaml" or file.suffix in {".db3", ".mcap"} for file in files)
            is_plain = all(file.is_file() and not file.is_symlink() for file in files)  # a folder may hold anything
            if path / "metadata.yaml" not in files or not (is_known and is_plain):
                raise OutputError(
                    f"{path}: exists and holds something other than a ROS 2 recording; choose another name"
                )
        check_old(old)

    folders = [path] if format == "sqlite3" else []
    return OutputTransaction(recording_names(path, format), folders=folders, check_old=check)


@contextlib.contextmanager
def recording_file(
    outputs: OutputTransaction, path: Path, format: RecordingFormat, *, rig_yaml: str, scenario_yaml: str
) -> Iterator[WriteMessage]:
    """Write a recording, which is complete when the block ends well.

    The true calibration and the scenario are attachments of an MCAP, else `NAME.rig.yaml` and `NAME.scenario.yaml`
    beside the bag.

    Raises:
        OutputError: it cannot be written.
    """
    texts = dict(zip(ATTACHMENTS, (rig_yaml, scenario_yaml), strict=True))
    part = outputs[path].part
    with output_errors(path), _sqlite_errors(path):
        if format == "mcap":
            with mcap_file(part, profile="ros2") as file:
                for name, text in texts.items():
                    file.attach(name, text)
                file.add_metadata(SIMULATED, {"attachments": ", ".join(texts)})
                yield _mcap_writer(file)
            return
        for name, text in texts.items():
            outputs[_beside(path, name)].write_text(marked_yaml(text))
        if format == "ros1":
            bag = Rosbag1Writer(part)
            bag.set_compression(Rosbag1Writer.CompressionFormat.LZ4)
            with bag:
                yield _rosbag_writer(bag)
        else:
            with Rosbag2Writer(part, version=METADATA_VERSION, storage_plugin=StoragePlugin.SQLITE3) as bag2:
                for key, value in FOLDER_DATA.items():
                    bag2.set_custom_data(key, value)
                yield _rosbag_writer(bag2)


def _beside(path: Path, name: str) -> Path:
    """A file beside a recording; its name begins with that of the recording."""
    return path.with_name(f"{path.name}.{name}")


@contextlib.contextmanager
def _sqlite_errors(path: Path) -> Iterator[None]:
    try:
        yield
    except sqlite3.Error as err:
        raise OutputError(f"{path}: cannot be written: {err}") from err


def _rosbag_writer(bag: Any) -> WriteMessage:
    """Writes to an open bag of rosbags."""
    connections: dict[str, Any] = {}

    def write(recorded: Recorded, start_ns: int) -> None:
        topic = recorded.topic
        if topic not in connections:
            options: Any = {"typestore": message_types(2), "offered_qos_profiles": [LATCHED] * recorded.latched}
            if isinstance(bag, Rosbag1Writer):
                latching = 1 if recorded.latched else None
                options = {"typestore": message_types(1), "latching": latching, "callerid": BAG_CALLER}
            connections[topic] = bag.add_connection(topic, recorded.msgtype, **options)
        bag.write(connections[topic], start_ns + recorded.log_ns, recorded.data)

    return write


def _mcap_writer(file: McapOutput) -> WriteMessage:
    channels: dict[str, int] = {}

    def write(recorded: Recorded, start_ns: int) -> None:
        topic = recorded.topic
        if topic not in channels:
            qos = LATCHED_YAML_HUMBLE if recorded.latched else None
            channels[topic] = file.add_ros2(topic, recorded.msgtype, qos)
        file.add_message(channels[topic], start_ns + recorded.log_ns, recorded.data)

    return write
