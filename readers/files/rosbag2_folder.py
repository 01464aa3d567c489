"""ROS 2 bag folders: their files, and the content of metadata.yaml.

A folder without them, or with others than metadata.yaml lists, raises a `RecordingError` that says what to do.
"""

from dataclasses import dataclass
from functools import lru_cache
from itertools import islice
from pathlib import Path, PurePosixPath
from typing import Any

import yaml

from lidcam.pipeline.core.errors import RecordingError
from lidcam.pipeline.core.settings.bounded_yaml import MAX_YAML_BYTES, parse_yaml
from lidcam.pipeline.core.text import listed, one_line
from lidcam.readers.natural_order import natural_key

METADATA = "metadata.yaml"
STORAGE_SUFFIXES = (".db3", ".mcap")

KITTI_RAW, KITTI_OTHERS = {"velodyne_points", "image_02", "image_03"}, {"velodyne", "image_2", "image_3", "label_2"}
"""Folders of KITTI's raw data, and of its odometry and objects."""

MAX_LOOKED_AT = 1000
"""Largest number of names on each level of a folder by which its kind is told."""


@dataclass(frozen=True, slots=True)
class FolderMetadata:
    """The part of metadata.yaml that is not in the files themselves."""

    file_names: tuple[str, ...] = ()  # The files in recording order
    message_compression: bool = False  # Whether each message is compressed with zstd
    distro: str = ""  # Name of the ROS 2 release, or empty


def unlisted_files(folder: Path) -> tuple[Path, ...]:
    """Files of a bag folder of the kind that metadata.yaml lists, which it does not list."""
    names = {_unpacked_name(name) for name in folder_metadata(folder).file_names}
    suffixes = {Path(name).suffix for name in names}
    files = [file for file in folder.iterdir() if _is_storage(file) and _storage_suffix(file) in suffixes]
    others = [file for file in files if _unpacked_name(file.name) not in names]
    return tuple(sorted(others, key=lambda file: natural_key(file.name)))


def recording_files(folder: Path) -> tuple[Path, ...]:
    """The files of a bag folder in recording order: those that metadata.yaml lists, else all, by their numbers."""
    files = tuple(folder / name for name in folder_metadata(folder).file_names)
    missing = [file.name for file in files if not file.is_file()]
    if missing:
        raise RecordingError(
            f"{folder}: {METADATA} lists {listed(missing)}, which "
            f"{'is' if len(missing) == 1 else 'are'} not there; complete the folder, or name the files to read"
        )
    if files:
        return files
    found = sorted((file for file in folder.iterdir() if _is_storage(file)), key=lambda file: natural_key(file.name))
    if len({_storage_suffix(file) for file in found}) > 1:
        names = ", ".join(file.name for file in found)
        raise RecordingError(
            f"{folder}: expected one recording, found several kinds of files ({names}); name the files"
        )
    if not found:
        bags = sum(file.suffix == ".bag" for file in folder.iterdir())
        hint = f"found {bags} ROS 1 .bag file(s): name them one by one" if bags else _hint(folder)
        raise RecordingError(f"{folder}: expected a ROS 2 bag folder ({METADATA}, .db3 or .mcap files), {hint}")
    return tuple(found)


def _hint(folder: Path) -> str:
    """The kind of a folder without recordings, and what to do."""
    below = {one.name for level in ("*", "*/*", "*/*/*") for one in islice(folder.glob(level), MAX_LOOKED_AT)}
    names = below.union(folder.absolute().parts[-2:])
    if "LIDAR_TOP" in names:
        return "found nuScenes: nuscenes2mcap (github.com/foxglove/nuscenes2mcap) makes an .mcap of each scene"
    if names & KITTI_RAW:
        return "found a drive of KITTI's raw data: `kitti2mcap` (pip install kitti2mcap) makes an .mcap of it"
    if names & KITTI_OTHERS:
        return "found frames of KITTI: write them to a recording first; `kitti2mcap` does that for its raw drives"
    return "found none of these"


def folder_metadata(folder: Path, *, is_recording: bool = True) -> FolderMetadata:
    """Content of the metadata.yaml of `folder`; the defaults if there is none.

    Beside a file that was given by itself, the folder is no recording, and a metadata.yaml may be anybody's.
    """
    path = folder / METADATA
    if not path.is_file():
        return FolderMetadata()
    expected = f"{path}: expected rosbag2's metadata (rosbag2_bagfile_information: relative_file_paths...)"
    remedy = "remove it to read all files of the folder"
    try:
        with path.open("rb") as stream:
            document = _parsed(stream.read(MAX_YAML_BYTES + 1))
        information: dict[str, Any] = document["rosbag2_bagfile_information"]
        names = tuple(PurePosixPath(name).name for name in information["relative_file_paths"])
        mode = str(information.get("compression_mode") or "").lower()
        compression = information.get("compression_format") or ""
        distro = str(information.get("ros_distro") or "")
    except (LookupError, TypeError, AttributeError, OSError, yaml.YAMLError, ValueError) as err:
        if not is_recording:
            return FolderMetadata()
        is_other = isinstance(err, LookupError | TypeError | AttributeError)
        found = "something else" if is_other else f"{type(err).__name__}: {one_line(err)}"
        raise RecordingError(f"{expected}, found {found}; {remedy}") from err
    if mode in {"message", "file"} and compression != "zstd":
        raise RecordingError(
            f"{path}: expected compression zstd, found {compression!r}; convert it with `ros2 bag convert`"
        )
    return FolderMetadata(names, mode == "message", distro)


@lru_cache(maxsize=1)
def _parsed(text: bytes) -> Any:
    """Parsed once where it is read several times in a row, which takes a second for hundreds of topics."""
    return parse_yaml(text)


def _unpacked_name(name: str) -> str:
    return name.removesuffix(".zstd")


def _storage_suffix(file: Path) -> str:
    return Path(file.stem).suffix if file.suffix == ".zstd" else file.suffix


def _is_storage(file: Path) -> bool:
    return file.is_file() and _storage_suffix(file) in STORAGE_SUFFIXES
