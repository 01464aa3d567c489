"""YAML files with bounds on size and depth, because a few lines of aliases can stand for billions of values."""

from pathlib import Path
from typing import Any

import yaml

from lidcam.pipeline.core.errors import ConfigError
from lidcam.pipeline.core.small_files import read_small_text

MAX_YAML_BYTES = 1 << 20
MAX_YAML_BRACKETS = 30
"""Depth of nested brackets; PyYAML goes through all open ones at every token."""
MAX_YAML_DEPTH = 100
MAX_YAML_VALUES = 20_000
"""Values in a file, each alias counted as what it stands for."""


class _Loader(yaml.SafeLoader):
    depth = values = 0

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        if self.depth == MAX_YAML_DEPTH:
            raise yaml.YAMLError("nested too deeply")
        if self.values == MAX_YAML_VALUES:  # before the rest is read
            raise yaml.YAMLError(f"more than {MAX_YAML_VALUES} values")
        self.depth += 1
        self.values += 1
        node: yaml.Node | None = super().compose_node(parent, index)
        self.depth -= 1
        return node

    def fetch_flow_collection_start(self, TokenClass: Any) -> None:
        if self.flow_level == MAX_YAML_BRACKETS:
            raise yaml.YAMLError(f"more than {MAX_YAML_BRACKETS} nested brackets")
        super().fetch_flow_collection_start(TokenClass)


def parse_yaml(text: str | bytes) -> Any:
    """The value that `yaml.safe_load` returns, of a text within the bounds.

    Raises:
        yaml.YAMLError: the text is not YAML, too large, or nested too deeply.
    """
    if len(text) > MAX_YAML_BYTES:
        raise yaml.YAMLError(f"more than {MAX_YAML_BYTES >> 20} MiB")
    loader = _Loader(text)
    try:
        node = loader.get_single_node()
        if node is None:
            return None
        _count_values(node, {})
        return loader.construct_document(node)
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as err:  # from dates and long numbers
        raise yaml.YAMLError(f"not a valid value: {err}") from err
    finally:
        loader.dispose()


def _count_values(node: yaml.Node, counts: dict[int, int]) -> int:
    """Number of values in a node; an aliased node is counted once and added at each alias."""
    if id(node) in counts:
        if not counts[id(node)]:
            raise yaml.YAMLError("a value that contains itself")
        return counts[id(node)]
    counts[id(node)] = 0
    parts: list[yaml.Node] = []
    if isinstance(node, yaml.SequenceNode):
        parts = node.value
    elif isinstance(node, yaml.MappingNode):
        parts = [part for pair in node.value for part in pair]
    counts[id(node)] = total = 1 + sum(_count_values(part, counts) for part in parts)
    if total > MAX_YAML_VALUES:
        raise yaml.YAMLError(f"more than {MAX_YAML_VALUES} values")
    return total


def read_yaml(path: Path) -> dict[str, Any]:
    """The mapping in a YAML file; empty for an empty file.

    Raises:
        ConfigError: the file cannot be read, is not YAML, or is not a mapping.
    """
    return yaml_mapping(read_small_text(path, MAX_YAML_BYTES, "a YAML file", ConfigError), path)


def yaml_mapping(text: str, path: Path) -> dict[str, Any]:
    """As `read_yaml`, of the text that was read from `path`."""
    try:
        tree = parse_yaml(text)
    except yaml.YAMLError as err:
        raise ConfigError(f"{path}: not YAML: {' '.join(str(err).split())}") from err
    if tree is None:
        return {}
    if not isinstance(tree, dict):
        raise ConfigError(f"{path}: expected a mapping of sections, found {type(tree).__name__}")
    return tree
