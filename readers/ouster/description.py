"""The JSON that says how to read an Ouster's packets: recorded beside them, or a file beside the recording."""

import json
from collections.abc import Iterator, Sequence
from contextlib import suppress
from itertools import islice
from pathlib import Path
from typing import Any

from lidcam.pipeline.core.errors import MessageError
from lidcam.readers.location import Location
from lidcam.readers.messages.deserialize import deserialize
from lidcam.readers.ouster.packets import METADATA, STRING, packet_data
from lidcam.readers.ouster.sensor import MAX_METADATA_CHARACTERS, sensor_of
from lidcam.readers.recording import Recording

DATA_PORT = 7502
"""Port to which Ousters send by default."""

PROBED = 20
"""Packets that are compared with a JSON: the first may be damaged, or not the lidar's."""


def find_description(recording: Recording, topic: str) -> str:
    """The JSON of the sensor whose packets a topic has; a `MessageError` says that there is none, or what to do."""
    recorded = [
        info.topic
        for info in recording.topics
        if info.msgtype == STRING and info.message_count and info.topic.endswith(METADATA)
    ]
    own = f"{topic.rpartition('/')[0]}/{METADATA}"
    recorded = [own] if own in recorded else recorded if len(recorded) == 1 else []
    for message in recording.messages(recorded) if recorded else ():
        found = str(deserialize(message).data)
        sensor_of(found)
        return found
    files = list(descriptions_beside(recording.paths))
    for message in islice(recording.messages([topic]) if files else (), PROBED):
        for _, text in files:
            with suppress(MessageError):
                sensor = sensor_of(text)
                if sensor.sends(packet_data(message, sensor.packet_bytes)):
                    return text
    if files:
        names = ", ".join(file.name for file, _ in files)
        raise MessageError(f"packets of an Ouster that {names} beside the recording does not describe")
    path = next(iter(recording.paths), Path("recording"))
    raise MessageError(
        f"packets of an Ouster without its JSON, which ouster-ros publishes on {own}: put it (from "
        f"http://SENSOR/api/v1/sensor/metadata) beside the recording as {Path(path.name).stem}.json"
    )


def descriptions_beside(paths: Sequence[Location]) -> Iterator[tuple[Path, str]]:
    """The JSON files beside a recording whose names begin alike, and their texts, in the order of names.

    `drive.json` and `drive_0.json` are beside `drive.pcap`, `os1.json` beside `os1_city.pcap`.
    """
    for path in paths:
        if not isinstance(path, Path):
            continue
        for file in sorted(path.parent.glob("*.json")):
            with suppress(OSError):  # who may not read it cannot use it
                is_named = file.name.startswith(path.stem) or path.name.startswith(file.stem)
                is_named &= not file.name.endswith(".foxglove.json")  # the layout beside a result
                if is_named and file.stat().st_size <= MAX_METADATA_CHARACTERS:
                    yield file, file.read_text(encoding="utf-8", errors="replace")


def ports(path: Location) -> frozenset[int]:
    """The ports to which the Ousters of a capture send, by the JSON files beside it."""
    named = (_port(text) for _, text in descriptions_beside([path]))
    return frozenset({DATA_PORT, *(port for port in named if port)})


def _port(text: str) -> int:
    try:
        found: Any = json.loads(text)
        port = found.get("config_params", found).get("udp_port_lidar", 0)
    except (ValueError, AttributeError, RecursionError):
        return 0
    return port if isinstance(port, int) and 0 < port < 1 << 16 else 0
