"""Names of sensors, and the topics of one camera, by the names of topics.

A topic splits into a place (namespace and the rest of the last part) and a role (words such as `image`, `raw`,
`camera_info`, `points`). Topics of one sensor share the place:

    /camera/image_raw      /camera/camera_info                        place: camera
    /image_raw_11          /camera_info_11      /detections_11        place: cam11
    /cam11/image/compressed  /cam11/camera_info  /cam11/detections    place: cam11
    /left/image_rect_color   /left_raw/image_raw_color                place: left
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from itertools import chain, count, takewhile

from lidcam.readers.natural_order import natural_key

TRANSPORTS = frozenset({"compressed", "compressedDepth", "draco", "ffmpeg", "foxglove", "theora", "zlib", "zstd"})
ROLE_WORDS = frozenset(
    {
        *("image", "img", "images", "raw", "color", "colour", "rgb", "bgr", "mono", "rect", "rectified"),
        *("camera", "cam", "info", "detections", "detection", "detections2d", "boxes", "bboxes", "boxes2d"),
        *("compressed", "video", "h264", "h265", "hevc"),
        *("points", "pointcloud", "pointcloud2", "cloud", "scan", "packets"),
    }
)
RECTIFICATION = frozenset({"raw", "rect", "rectified"})
"""Role words of namespaces, too."""

NOT_IMAGES = frozenset(
    {"depth", "disparity", "mask", "masks", "label", "labels", "segmentation", "semantic", "confidence"}
    | {"compresseddepth"}
)
TRUTH_FOLDER = "/ground_truth/"
"""All topics below it are truth, of any type."""

BOX_TYPES = frozenset({"vision_msgs/msg/Detection2DArray", "vision_msgs/msg/Detection3DArray"})
_TRUTH = re.compile(r"(?:^|[/_])(?:ground_?truth|truth|gt|annotations?)(?:$|[/_])", re.IGNORECASE)
_NUMBERED = re.compile(r"^(?:camera|cam|image|img)?_?(\d+)$")


def is_truth(topic: str, msgtype: str) -> bool:
    """Whether a topic is truth and no measurement: all below `/ground_truth/`, and boxes whose name says so.

    The words are `ground_truth`, `truth`, `gt` and `annotations`, between slashes or underscores.
    """
    return topic.startswith(TRUTH_FOLDER) or (msgtype in BOX_TYPES and bool(_TRUTH.search(topic)))


def transport_free(topic: str) -> str:
    """The topic without the last part of image_transport and point_cloud_transport: `/points/draco` is `/points`."""
    head, _, tail = topic.rpartition("/")
    return head if tail in TRANSPORTS and head else topic


def is_measured_image(topic: str) -> bool:
    """Whether a topic's name does not say depth, mask or label image."""
    return NOT_IMAGES.isdisjoint(re.split(r"[/_]", topic.lower()))


def is_rectified(topic: str) -> bool:
    """Whether a topic's name says that its images are rectified (image_proc: `image_rect...`)."""
    words = re.split(r"[/_]", transport_free(topic).lower().rpartition("/")[2])
    return "rect" in words or "rectified" in words


def place(topic: str) -> tuple[str, ...]:
    """The parts of a topic that name its sensor; `11` and `camera_11` become `cam11`."""
    return tuple(_NUMBERED.sub(r"cam\1", part) for part in _parts(topic))


def _parts(topic: str) -> tuple[str, ...]:
    *spaces, last = [part for part in transport_free(topic).removesuffix("lidar_packets").split("/") if part] or [""]
    left = [*(_without(RECTIFICATION, space) for space in spaces), _without(ROLE_WORDS, last)]
    return tuple(filter(None, left))


def _without(words: frozenset[str], part: str) -> str:
    return "_".join(word for word in part.split("_") if word.lower() not in words)


def pair_score(topic: str, other: str, *, same_frame: bool) -> tuple[int, int, int]:
    """Score of two topics as topics of one camera: by place, then by frame, then by shared leading parts.

    The first number is 0 if they do not fit: topics of different places need the same frame.
    """
    same_place = place(topic) == place(other)
    shared = [*takewhile(lambda pair: pair[0] == pair[1], zip(topic.split("/"), other.split("/"), strict=False))]
    return (2 if same_place else 1 if same_frame else 0, int(same_frame), len(shared))


def sensor_names(topics: Sequence[str], kind: str, *, taken: Iterable[str] = ()) -> Mapping[str, str]:
    """Short names by topic: the place, without the parts that all share; unique, and unlike `taken`.

    `/velodyne1_points` is `velodyne1`, `/image_raw_11` is `cam11`, `/camera/image_raw` is `camera`,
    `/sensing/lidar/left/points` beside `.../right/points` is `left`; a topic without a place is named by `kind`.
    """
    parts = {topic: [re.sub(r"\W", "_", p, flags=re.ASCII) for p in _parts(topic)] or [kind] for topic in topics}
    while len(parts) > 1 and all(len(p) > 1 for p in parts.values()) and len({p[0] for p in parts.values()}) == 1:
        parts = {topic: p[1:] for topic, p in parts.items()}
    short = "cam" if kind == "camera" else kind
    names = {topic: "_".join(p) for topic, p in parts.items()}
    names = {topic: f"{short}{name}" if name[:1].isdigit() else name for topic, name in names.items()}
    used, unique = set(taken), {}
    for topic in sorted(names, key=natural_key):
        name = names[topic]
        candidates = chain([name, f"{name}_{kind}"], (f"{name}_{kind}_{number}" for number in count(2)))
        unique[topic] = next(candidate for candidate in candidates if candidate not in used)
        used.add(unique[topic])
    return unique
