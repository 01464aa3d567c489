"""Writes simulated recordings: ROS 1 bag, ROS 2 sqlite3 folder, MCAP.

The same messages give the same bytes. A file is a `.part` beside its name until it is complete.
"""

import contextlib
import shutil
from collections.abc import Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any, Literal, Protocol

from rosbags.rosbag1 import Writer as Rosbag1Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Rosbag2Writer

from bags.simulator.recorder.recorded import Recorded
from pipeline.core.ending import undone_at_once
from pipeline.core.errors import OutputError
from pipeline.core.ros.messages import ROS2
from pipeline.core.ros.qos import LATCHED, LATCHED_YAML_HUMBLE
from pipeline.core.ros.typestores import RosVersion, message_types
from writers.atomic import atomic_output, output_errors
from writers.mcap.file import McapOutput, mcap_file

__all__ = ["FORMATS", "MessageWriter", "RecordingFormat", "format_of", "recording_file", "ros_version_of"]

RecordingFormat = Literal["ros1", "sqlite3", "mcap"]
FORMATS: tuple[RecordingFormat, ...] = ("ros1", "sqlite3", "mcap")

ENDINGS = "a name that ends in .bag (ROS 1), in .mcap (MCAP), or has no ending (ROS 2 sqlite3 folder), or a --format"
METADATA_VERSION: Literal[8] = 8
"""The newest that Humble reads."""


class MessageWriter(Protocol):
    """An open recording."""

    def write(self, recorded: Recorded, start_ns: int) -> None:
        """Add a message of a scenario that began at `start_ns` since 1970; log times must not decrease."""
        ...


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


@contextlib.contextmanager
def recording_file(
    path: Path, format: RecordingFormat, *, rig_yaml: str, scenario_yaml: str
) -> Iterator[MessageWriter]:
    """Write a recording; an older one of that name is replaced when the new one is complete.

    Args:
        path: File, or folder for sqlite3.
        format: Format of the recording.
        rig_yaml: The true calibration as a rig file: an attachment of an MCAP, else `NAME.rig.yaml` beside the bag.
        scenario_yaml: The scenario: an attachment of an MCAP, else `NAME.scenario.yaml` beside the bag.

    Raises:
        OutputError: it cannot be written, or something else stands there.
    """
    texts = {"rig.yaml": rig_yaml, "scenario.yaml": scenario_yaml}
    if format == "mcap":
        with output_errors(path), mcap_file(path, profile="ros2") as file:
            for name, text in texts.items():
                file.attach(name, text)
            file.add_metadata("lidcam_truth", {"attachments": ", ".join(texts)})
            yield _Mcap(file)
    elif format == "ros1":
        with atomic_output(path) as part, _beside(path, texts), output_errors(path):
            part.unlink()
            bag = Rosbag1Writer(part)
            bag.set_compression(Rosbag1Writer.CompressionFormat.LZ4)
            with bag:
                yield _Rosbag(bag)
    else:
        with _atomic_folder(path) as folder, _beside(path, texts), output_errors(path):
            with Rosbag2Writer(folder, version=METADATA_VERSION, storage_plugin=StoragePlugin.SQLITE3) as bag2:
                yield _Rosbag(bag2)
            _rename_inside(folder, path.name)


@contextlib.contextmanager
def _beside(path: Path, texts: Mapping[str, str]) -> Iterator[None]:
    """Write texts to files beside a recording; their names are suffixes of its name."""
    with contextlib.ExitStack() as files:
        for name, text in texts.items():
            part = files.enter_context(atomic_output(path.with_name(f"{path.name}.{name}")))
            part.write_text(text, encoding="utf-8")
        yield


@contextlib.contextmanager
def _atomic_folder(path: Path) -> Iterator[Path]:
    """As `atomic_output`, for a ROS 2 bag folder; an older one is replaced, anything else is refused."""
    with output_errors(path):
        if path.exists() and not _is_recorded(path):
            raise OutputError(f"{path}: exists and holds something other than a ROS 2 recording; choose another name")
        if not path.parent.is_dir():
            raise OutputError(f"{path}: there is no folder {path.parent}; create it first")
        part = path.with_name(f"{path.name}.part")
        shutil.rmtree(part, ignore_errors=True)
    try:
        with undone_at_once(partial(shutil.rmtree, part, ignore_errors=True)):
            yield part
            with output_errors(path):
                if path.exists():
                    shutil.rmtree(path)
                part.replace(path)
    except BaseException:
        shutil.rmtree(part, ignore_errors=True)
        raise


def _is_recorded(path: Path) -> bool:
    """Whether a folder holds a ROS 2 recording and nothing else."""
    if not path.is_dir() or not (path / "metadata.yaml").is_file():
        return False
    return all(file.name == "metadata.yaml" or file.suffix in {".db3", ".mcap"} for file in path.iterdir())


def _rename_inside(folder: Path, name: str) -> None:
    """Rename the database, which rosbags named after the `.part` folder, to match the final folder."""
    written = folder / f"{folder.name}.db3"
    written.rename(folder / f"{name}.db3")
    metadata = folder / "metadata.yaml"
    metadata.write_text(metadata.read_text(encoding="utf-8").replace(written.name, f"{name}.db3"), encoding="utf-8")


class _Rosbag:
    def __init__(self, bag: Rosbag1Writer | Rosbag2Writer) -> None:
        self._bag: Any = bag
        self._connections: dict[str, Any] = {}

    def write(self, recorded: Recorded, start_ns: int) -> None:
        """See `MessageWriter`."""
        topic = recorded.topic
        if topic not in self._connections:
            if isinstance(self._bag, Rosbag1Writer):
                options: Any = {"typestore": message_types(1), "latching": 1 if recorded.latched else None}
            else:
                profiles = [LATCHED] if recorded.latched else []
                options = {"typestore": message_types(2), "offered_qos_profiles": profiles}
            self._connections[topic] = self._bag.add_connection(topic, recorded.msgtype, **options)
        self._bag.write(self._connections[topic], start_ns + recorded.log_ns, recorded.data)


class _Mcap:
    def __init__(self, file: McapOutput) -> None:
        self._file = file
        self._channels: dict[str, int] = {}

    def write(self, recorded: Recorded, start_ns: int) -> None:
        """See `MessageWriter`."""
        topic, msgtype = recorded.topic, recorded.msgtype
        if topic not in self._channels:
            schema = msgtype, "ros2msg", ROS2.definition(msgtype).encode()
            profiles = {"offered_qos_profiles": LATCHED_YAML_HUMBLE} if recorded.latched else {}
            self._channels[topic] = self._file.add_channel(topic, "cdr", schema, profiles)
        self._file.add_message(self._channels[topic], start_ns + recorded.log_ns, recorded.data)
