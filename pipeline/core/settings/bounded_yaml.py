"""YAML files with bounds on size and depth: in recordings, a few lines of aliases can stand for billions of values."""

from pathlib import Path
from typing import Any

import yaml
from yaml.composer import Composer

from lidcam.pipeline.core.errors import ConfigError
from lidcam.pipeline.core.small_files import read_small_text

MAX_YAML_BYTES = 1 << 20
MAX_YAML_DEPTH = 100
MAX_YAML_VALUES = 20_000
"""Values in a file, each alias counted as what it stands for."""


class _Loader(Composer, yaml.CSafeLoader):
    """Takes the events of the C parser, which needs a tenth of the time, and composes the nodes one by one."""

    def __init__(self, text: str | bytes) -> None:
        Composer.__init__(self)
        yaml.CSafeLoader.__init__(self, text)
        self._depth = self._values = 0
        self._weights: dict[int, int] = {}  # values in a node; none yet in one that contains itself

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        if self._depth == MAX_YAML_DEPTH:
            raise yaml.YAMLError("nested too deeply")
        is_alias, before = self.check_event(yaml.AliasEvent), self._values
        self._depth += 1
        node: yaml.Node | None = super().compose_node(parent, index)
        self._depth -= 1
        self._values += self._weights.get(id(node), MAX_YAML_VALUES) if is_alias else 1
        if self._values > MAX_YAML_VALUES:
            raise yaml.YAMLError(f"more than {MAX_YAML_VALUES} values")
        self._weights.setdefault(id(node), self._values - before)
        return node

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        """As a SafeLoader does, which takes the last of several equal keys without a word."""
        seen: set[str] = set()
        for key, _ in node.value:
            if key.tag == "tag:yaml.org,2002:str" and key.value in seen:
                raise yaml.YAMLError(f"{key.value!r} is given twice, again in line {key.start_mark.line + 1}")
            seen.add(key.value if isinstance(key.value, str) else "")
        return super().construct_mapping(node, deep)


_Loader.add_constructor(
    "tag:yaml.org,2002:opencv-matrix",
    lambda loader, node: loader.construct_mapping(node, deep=True),  # type: ignore[arg-type]  # a mapping
)


def parse_yaml(text: str | bytes) -> Any:
    """The value that `yaml.safe_load` returns, of a text within the bounds.

    Raises:
        yaml.YAMLError: the text is not YAML, too large, or nested too deeply.
    """
    if len(text) > MAX_YAML_BYTES:
        raise yaml.YAMLError(f"more than {MAX_YAML_BYTES >> 20} MiB")
    try:
        return yaml.load(text, _Loader)  # noqa: S506  # a SafeLoader
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as err:  # from dates and long numbers
        raise yaml.YAMLError(f"not a valid value: {err}") from err


def read_yaml(path: Path) -> dict[str, Any]:
    """The mapping in a YAML file, or an empty file; raises ConfigError if it cannot be read, or is something else."""
    return yaml_mapping(read_small_text(path, MAX_YAML_BYTES, "a YAML file", ConfigError), path)


def yaml_mapping(text: str, path: Path) -> dict[str, Any]:
    """The mapping in a text that was read from `path`; see `read_yaml`."""
    try:
        tree = parse_yaml(text)
    except yaml.YAMLError as err:
        raise ConfigError(f"{path}: not YAML: {' '.join(str(err).split())}") from err
    if tree is None:
        return {}
    if not isinstance(tree, dict):
        raise ConfigError(f"{path}: expected a mapping of sections, found {type(tree).__name__}")
    return tree
