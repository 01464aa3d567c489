"""YAML that stands for more than it says."""

from pathlib import Path

import pytest
import yaml

from lidcam.pipeline.core.errors import ConfigError
from lidcam.pipeline.core.settings.bounded_yaml import parse_yaml, read_yaml
from lidcam.readers.rig.rig_file import load_rig

LAUGHS = "a: &a [1, 1]\n" + "\n".join(
    f"{chr(98 + i)}: &{chr(98 + i)} [{', '.join([f'*{chr(97 + i)}'] * 9)}]" for i in range(20)
)
MERGES = "a: &a {x: 1}\n" + "\n".join(
    f"{chr(98 + i)}: &{chr(98 + i)}\n  <<: [{', '.join([f'*{chr(97 + i)}'] * 9)}]" for i in range(20)
)


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        (LAUGHS, "more than 2000 values"),
        ("a: [" + "1," * 2000 + "}", "more than 2000 values"),  # before the rest is read
        (MERGES, "more than 2000 values"),
        ("a: &a [*a]", "more than 2000 values"),  # contains itself
        ("a: " + "[" * 10_000, "nested too deeply"),
        ("- " * 2000 + "a", "nested too deeply"),
        ("a: 2001-99-99", "not a valid value: month must be in 1..12"),
        (f"a: {'9' * 5000}", "not a valid value"),
        ("a: {b: 1}\nc: 2\na: {d: 3}", "'a' is given twice, again in line 3"),
    ],
)
def test_what_stands_for_too_much_is_refused_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str, fault: str
) -> None:
    """At the bound that the error names: without it, some of these would take years."""
    monkeypatch.setattr("lidcam.pipeline.core.settings.bounded_yaml.MAX_YAML_VALUES", 2000)
    path = tmp_path / "a.yaml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=rf"a\.yaml: not YAML: .*{fault}"):
        read_yaml(path)
    with pytest.raises(ConfigError, match=r"a\.yaml: not YAML"):
        load_rig(path)


def test_a_file_that_is_too_large(tmp_path: Path) -> None:
    path = tmp_path / "a.yaml"
    path.write_text("a: " + "b" * (1 << 20))
    with pytest.raises(ConfigError, match=r"a\.yaml: cannot be read as a YAML file: expected at most 1 MiB"):
        read_yaml(path)
    with pytest.raises(yaml.YAMLError, match="more than 1 MiB"):
        parse_yaml(path.read_bytes())


def test_aliases_and_merges_in_measure() -> None:
    text = "base: &b {x: 1, y: [1, 2]}\nother:\n  <<: *b\n  x: 2\nagain: *b\n"
    assert parse_yaml(text) == yaml.safe_load(text)
    assert parse_yaml(text)["other"] == {"x": 2, "y": [1, 2]}
    assert parse_yaml("") is None
