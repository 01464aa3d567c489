"""What topic names tell: which topics belong to one camera, and what a sensor is called.

A topic splits into a place (namespace and what is left of the last part) and a role (words such as `image`, `raw`,
`camera_info`, `points`). Topics of one sensor share the place:

    /camera/image_raw      /camera/camera_info                        place: camera
    /image_raw_11          /camera_info_11      /detections_11        place: cam11
    /cam11/image/compressed  /cam11/camera_info  /cam11/detections    place: cam11
"""

import re
from collections.abc import Iterable, Mapping, Sequence

from readers.natural_order import natural_key

__all__ = ["is_measured_image", "is_rectified", "pair_score", "place", "sensor_names", "transport_free"]

TRANSPORTS = frozenset({"compressed", "compressedDepth", "theora", "ffmpeg", "foxglove", "zstd"})
ROLE_WORDS = frozenset(
    {
        *("image", "img", "images", "raw", "color", "colour", "rgb", "bgr", "mono", "rect", "rectified"),
        *("camera", "cam", "info", "detections", "detection", "detections2d", "boxes", "bboxes", "boxes2d"),
        *("compressed", "video", "h264", "h265", "hevc"),
        *("points", "pointcloud", "pointcloud2", "cloud", "scan", "packets"),
    }
)
NOT_IMAGES = frozenset(
    {
        "depth",
        "disparity",
        "mask",
        "masks",
        "label",
        "labels",
        "segmentation",
        "semantic",
        "confidence",
        "compresseddepth",
    }
)
_NUMBERED = re.compile(r"^(?:camera|cam|image|img)?_?(\d+)$")


def transport_free(topic: str) -> str:
    """The topic without image_transport's last part: `/camera/image_raw/compressed` is `/camera/image_raw`."""
    head, _, tail = topic.rpartition("/")
    return head if tail in TRANSPORTS and head else topic


def is_measured_image(topic: str) -> bool:
    """Whether a topic's name says that it shows what a person would see: no depth, mask or label image."""
    words = re.split(r"[/_]", topic.lower())
    return not NOT_IMAGES.intersection(words)


def is_rectified(topic: str) -> bool:
    """Whether a topic's name says that its images are free of distortion (image_proc: `image_rect...`)."""
    words = re.split(r"[/_]", transport_free(topic).lower().rpartition("/")[2])
    return "rect" in words or "rectified" in words


def place(topic: str) -> tuple[str, ...]:
    """The parts of a topic that name its sensor; numbers alone, and `camera_11`, become `cam11`."""
    return tuple(_NUMBERED.sub(r"cam\1", part) for part in _parts(topic))


def _parts(topic: str) -> tuple[str, ...]:
    *spaces, last = [part for part in transport_free(topic).split("/") if part] or [""]
    left = "_".join(word for word in last.split("_") if word.lower() not in ROLE_WORDS)
    return (*spaces, left) if left else tuple(spaces)


def pair_score(topic: str, other: str, *, same_frame: bool) -> tuple[int, int, int]:
    """How well two topics fit one camera: by place, then by frame, then by shared leading parts; 0 first: not at all.

    Topics of different places fit only if their messages name the same frame.
    """
    same_place = place(topic) == place(other)
    shared = 0
    for one, two in zip(topic.split("/"), other.split("/"), strict=False):
        if one != two:
            break
        shared += 1
    return (2 if same_place else 1 if same_frame else 0, int(same_frame), shared)


def sensor_names(topics: Sequence[str], kind: str, *, taken: Iterable[str] = ()) -> Mapping[str, str]:
    """Short names by topic: the place, without what all share; unique, and none of `taken`.

    `/velodyne1_points` is `velodyne1`, `/image_raw_11` is `cam11`, `/camera/image_raw` is `camera`,
    `/sensing/lidar/left/points` beside `.../right/points` is `left`; a topic that is all role is named by `kind`.
    """
    parts = {topic: [_word(part) for part in _parts(topic)] or [kind] for topic in topics}
    while len(parts) > 1 and all(len(p) > 1 for p in parts.values()) and len({p[0] for p in parts.values()}) == 1:
        parts = {topic: p[1:] for topic, p in parts.items()}
    short = "cam" if kind == "camera" else kind
    names = {topic: "_".join(p) for topic, p in parts.items()}
    names = {topic: f"{short}{name}" if name[:1].isdigit() else name for topic, name in names.items()}
    used, unique = set(taken), {}
    for topic in sorted(names, key=natural_key):
        name, number = names[topic], 2
        if name in used:
            name = f"{name}_{kind}"
        base = name
        while name in used:
            name, number = f"{base}_{number}", number + 1
        used.add(name)
        unique[topic] = name
    return unique


def _word(part: str) -> str:
    return re.sub(r"\W", "_", part, flags=re.ASCII)
