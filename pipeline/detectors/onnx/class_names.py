"""Names of the classes that a network tells apart."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from lidcam.pipeline.core.errors import ConfigError, ModelError
from lidcam.pipeline.core.settings.bounded_yaml import MAX_YAML_BYTES, parse_yaml
from lidcam.pipeline.core.small_files import read_small_file

# fmt: off
COCO_LABELS: tuple[str, ...] = (
    "person", "bicycle", "car", "motorcycle", "airplane", "bus", "train", "truck", "boat", "traffic light",
    "fire hydrant", "stop sign", "parking meter", "bench", "bird", "cat", "dog", "horse", "sheep", "cow",
    "elephant", "bear", "zebra", "giraffe", "backpack", "umbrella", "handbag", "tie", "suitcase", "frisbee",
    "skis", "snowboard", "sports ball", "kite", "baseball bat", "baseball glove", "skateboard", "surfboard",
    "tennis racket", "bottle", "wine glass", "cup", "fork", "knife", "spoon", "bowl", "banana", "apple",
    "sandwich", "orange", "broccoli", "carrot", "hot dog", "pizza", "donut", "cake", "chair", "couch",
    "potted plant", "bed", "dining table", "toilet", "tv", "laptop", "mouse", "remote", "keyboard", "cell phone",
    "microwave", "oven", "toaster", "sink", "refrigerator", "book", "clock", "vase", "scissors", "teddy bear",
    "hair drier", "toothbrush",
)
# fmt: on
"""The 80 object names of COCO 2017 (cocodataset.org), in the order of network outputs."""

COCO91_LABELS: tuple[str, ...] = tuple(
    dict(zip(sorted({*range(1, 91)} - {12, 26, 29, 30, 45, 66, 68, 69, 71, 83}), COCO_LABELS, strict=True)).get(row, "")
    for row in range(91)
)
"""COCO's names by the numbers of its annotations, from 1 (person) to 90; ten of these have none."""

KNOWN = {"coco": COCO_LABELS, "coco91": COCO91_LABELS}
REMEDY = (
    "set detect2d.names to a file with a name in each line, to a YAML file with `names`, to coco (80 names) or to "
    "coco91 (the same with gaps)"
)


def class_names(wanted: str, metadata: Mapping[str, str], class_count: int | None) -> tuple[str, ...]:
    """Names by number of the class.

    Args:
        wanted: `coco`, `coco91`, a file, or empty: what the network's own file says, else COCO's if there are 80.
        metadata: Metadata of the network's file; `names` holds names as Ultralytics writes them.
        class_count: Classes of the network; None if it does not say.

    Raises:
        ConfigError: the file that is wanted cannot be read.
        ModelError: there are no names, or not as many as classes.
    """
    if wanted:
        names, source = KNOWN.get(wanted) or _file_names(Path(wanted)), f"detect2d.names ({wanted})"
    elif "names" in metadata:
        names, source = _own_names(metadata["names"]), "its file"
    elif class_count == len(COCO_LABELS):
        return COCO_LABELS
    else:
        size = "does not say how many classes it has" if class_count is None else f"has {class_count} classes"
        raise ModelError(f"the network {size}, and its file has no names for them: {REMEDY}")
    if class_count not in (None, len(names)):
        raise ModelError(f"the network has {class_count} classes, and {source} has {len(names)} names: {REMEDY}")
    return names


def _own_names(text: str) -> tuple[str, ...]:
    """Names from a Python dictionary with plain keys, which is YAML, too."""
    try:
        return _listed(parse_yaml(text))
    except yaml.YAMLError as err:
        raise ModelError(f"its file has names for its classes that cannot be read: {REMEDY}") from err


def _file_names(path: Path) -> tuple[str, ...]:
    """Names from a file: lines, YAML (as data sets of Ultralytics have) or JSON (as configurations of Transformers)."""
    try:
        text = read_small_file(path, MAX_YAML_BYTES).decode("utf-8-sig")
        is_yaml = path.suffix in {".yaml", ".yml", ".json"}
        found = parse_yaml(text) if is_yaml else [line.strip() for line in text.rstrip().splitlines()]
        if isinstance(found, dict):
            found = next((found[key] for key in ("names", "id2label") if key in found), found)
        return _listed(found)
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as err:
        reason = err.strerror if isinstance(err, OSError) else "it holds none"
        raise ConfigError(f"detect2d.names: {path}: expected names of classes: {reason}") from err


def _listed(found: Any) -> tuple[str, ...]:
    """Names from a list, or from a mapping by number; else a YAMLError."""
    if isinstance(found, dict):
        numbered = {int(key): name for key, name in found.items() if str(key).isdecimal()}
        found = [numbered.get(row) for row in range(len(found))]
    if not isinstance(found, list) or not found or not all(isinstance(name, str) for name in found):
        raise yaml.YAMLError("expected names")
    return tuple(name.strip() for name in found)
