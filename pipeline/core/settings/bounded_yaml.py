"""YAML of a bounded size: a few lines of aliases can stand for billions of values."""

from pathlib import Path
from typing import Any

import yaml

from pipeline.core.errors import ConfigError

__all__ = ["MAX_YAML_BYTES", "parse_yaml", "read_yaml"]

MAX_YAML_BYTES = 1 << 20
MAX_YAML_BRACKETS = 30
"""Brackets in one another; PyYAML looks at all of them again at every word."""
MAX_YAML_VALUES = 100_000
"""Values in a file, each alias counted as what it stands for: a few lines of them can stand for billions."""


class _Loader(yaml.SafeLoader):
    def fetch_flow_collection_start(self, TokenClass: Any) -> None:
        if self.flow_level == MAX_YAML_BRACKETS:
            raise yaml.YAMLError(f"more than {MAX_YAML_BRACKETS} brackets in one another")
        super().fetch_flow_collection_start(TokenClass)


def parse_yaml(text: str | bytes) -> Any:
    """What `yaml.safe_load` gives, of a file that holds a bounded number of values.

    Raises:
        yaml.YAMLError: it is no YAML, too large, or nested too deeply.
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
    except RecursionError as err:
        raise yaml.YAMLError("nested too deeply") from err
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as err:  # of dates and long numbers
        raise yaml.YAMLError(f"a value that is none: {err}") from err
    finally:
        loader.dispose()


def _count_values(node: yaml.Node, counts: dict[int, int]) -> int:
    """Values that a node stands for; those of aliases are counted once and added each time."""
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
    """A YAML file that holds a mapping.

    Raises:
        ConfigError: the file cannot be read, is not YAML, or holds something else.
    """
    try:
        with path.open(encoding="utf-8") as stream:
            tree = parse_yaml(stream.read(MAX_YAML_BYTES + 1))
    except (OSError, UnicodeDecodeError) as err:
        raise ConfigError(f"{path}: cannot be read: {err}") from err
    except yaml.YAMLError as err:
        raise ConfigError(f"{path}: not YAML: {' '.join(str(err).split())}") from err
    if tree is None:
        return {}
    if not isinstance(tree, dict):
        raise ConfigError(f"{path}: expected a mapping of sections, found {type(tree).__name__}")
    return tree
