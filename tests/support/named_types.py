"""The message types that lidcam's sources name, as rosbags has them, for `pipeline/core/ros/definitions/ros*.json`.

`python tests/support/named_types.py` writes the files anew.
"""

import json
import re
from pathlib import Path

from helpers import ROOT
from rosbags.typesys import Stores

from lidcam.pipeline.core.ros.typestores import RosVersion, release_types
from lidcam.readers.messages.deserialize import type_parts

PACKAGES = ("lidcam", "bags", "readers", "writers", "pipeline")
RELEASES: dict[RosVersion, Stores] = {1: Stores.ROS1_NOETIC, 2: Stores.ROS2_HUMBLE}


def file_of(ros_version: RosVersion) -> Path:
    return ROOT / f"pipeline/core/ros/definitions/ros{ros_version}.json"


def named_types(ros_version: RosVersion) -> str:
    """The text of the file."""
    known = release_types(RELEASES[ros_version]).fielddefs
    sources = (path.read_text() for package in PACKAGES for path in (ROOT / package).rglob("*.py"))
    wanted = {name for text in sources for name in re.findall(r"\b\w+/msg/\w+", text) if name in known}
    found = {}
    while wanted:
        name = wanted.pop()
        found[name] = known[name]
        wanted |= {*type_parts(known[name][1])} - found.keys()
    lines = (f"{json.dumps(name)}: {json.dumps(found[name])}" for name in sorted(found))
    return "{\n" + ",\n".join(lines) + "\n}\n"


if __name__ == "__main__":
    for version in RELEASES:
        file_of(version).write_text(named_types(version))
        print(f"wrote {file_of(version)}")
