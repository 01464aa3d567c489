import re
from pathlib import Path
from typing import Annotated, Any, Literal

import pytest
from pydantic import Field
from wrong_values import mistakes, words_of_the_library

from lidcam.pipeline.core.errors import CalibrationError, ConfigError
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.core.settings.load import set_values
from lidcam.pipeline.core.settings.model import Count, Positive, SettingsModel, Topic
from lidcam.pipeline.core.settings.validation import checked, key_places


def message(model: type[SettingsModel], tree: dict[str, Any]) -> str:
    with pytest.raises(ConfigError) as caught:
        checked(model, tree, "file")
    text = str(caught.value)
    assert text.startswith("file: ")
    assert caught.value.__cause__ is None
    return text.removeprefix("file: ")


class Part(SettingsModel):
    size_m: tuple[Positive, Positive, Positive]
    corner: tuple[int, str] = (0, "")


class Everything(SettingsModel):
    flag: bool = True
    whole: Count = 1
    number: Annotated[float, Field(gt=0, lt=90)] = 1.0
    low: Annotated[float, Field(le=5)] = 1.0
    optional: Positive | None = None
    path: Path | None = None
    choice: Literal["a", "b"] = "a"
    only: Literal["x"] = "x"
    topics: tuple[Topic, ...] = ()
    named: dict[str, Part] = Field(default_factory=dict)
    parts: Annotated[list[Part], Field(min_length=1)] = [Part(size_m=(1, 1, 1))]  # noqa: RUF012  # pydantic copies it
    rows: tuple[tuple[float, float] | tuple[float, float, float], ...] = ()
    either: Literal["all"] | tuple[Topic, ...] = "all"
    code: Annotated[str, Field(pattern="^[a-z]+$")] = "a"
    keyed: dict[Annotated[str, Field(pattern="^[a-z]+$")], int] = Field(default_factory=dict)
    part: Part = Part(size_m=(1, 1, 1))


SIZE = {"size_m": [1, 1, 1]}
SIZES = "expected a number of 9e+09 or less in size, found "


@pytest.mark.parametrize(
    ("tree", "text"),
    [
        ({"flag": "maybe"}, "flag: expected true or false, found 'maybe'"),
        ({"whole": 0}, "whole: expected a whole number of 1 or more, found 0"),
        ({"whole": 1.5}, "whole: expected a whole number of 1 or more, found 1.5"),
        ({"whole": None}, "whole: expected a whole number of 1 or more, found null"),
        ({"number": 90}, "number: expected a number above 0 and below 90, found 90"),
        ({"number": float("inf")}, "number: expected a finite number, found .inf"),
        ({"optional": 1e-300}, "optional: expected a number of 1e-09 or more, found 1.0e-300"),
        ({"low": -1e300}, f"low: {SIZES}-1.0e+300"),
        (
            {"whole": 10**5000},
            "whole: expected a number of 9e+09 or less in size, found a number of thousands of digits",
        ),
        ({"flag": 10**5000}, "flag: expected true or false, found a number of thousands of digits"),
        ({"rows": [[1, 1e10]]}, f"rows: {SIZES}10000000000.0"),
        ({"low": 6}, "low: expected a number of 5 or less, found 6"),
        ({"optional": "x"}, "optional: expected a number above 0 or null, found 'x'"),
        ({"path": 3}, "path: expected the path of a file or null, found 3"),
        ({"choice": True}, "choice: expected one of a, b, found true"),
        ({"only": "y"}, "only: expected x, found 'y'"),
        ({"topics": "/a"}, "topics: expected a list of topics, for instance [/velodyne_points], found '/a'"),
        ({"topics": [1]}, "topics.0: expected a topic, found 1"),
        ({"named": []}, "named: expected a section of names with sections with the keys size_m, corner, found []"),
        ({"named": {"a": 3}}, "named.a: expected a section with the keys size_m, corner, found 3"),
        ({"named": {"a": {}}}, "named.a.size_m is missing: expected a list of 3 numbers above 0"),
        ({"parts": []}, "parts: expected a list of at least 1 sections with the keys size_m, corner, found []"),
        ({"parts": [{"size_m": [1]}]}, "parts.0.size_m.1 is missing: expected a number above 0 (and 1 more)"),
        ({"parts": [{"size_m": [1, 2, 0]}]}, "parts.0.size_m.2: expected a number above 0, found 0"),
        ({"rows": [[1, "x"]]}, "rows.0: expected a list of 2 numbers or a list of 3 numbers, found [1, x]"),
        ({"either": 5}, "either: expected all or a list of topics, for instance [/velodyne_points], found 5"),
        ({"code": "A"}, "code: expected text of the form ^[a-z]+$, found 'A'"),
        ({"keyed": {"A": 1}}, "keyed.A: expected a name of letters, digits and _, found 'A'"),
        ({"keyed": {2: 1}}, "keyed: expected a name of letters, digits and _, found 2"),
        ({"part": SIZE | {"corner": [1, 2, 3]}}, "part.corner: expected a list of 2 whole numbers, found [1, 2, 3]"),
        ({"flag": {}}, "flag: expected true or false, found an empty section"),
        ({"flag": {"a": 1, "b": 2}}, "flag: expected true or false, found a section with the keys a, b"),
        ({"flag": "x" * 500}, f"flag: expected true or false, found '{'x' * 119}..."),
        ({"flag": object}, "flag: expected true or false, found <class 'object'>"),
        ({"whole": 0, "low": 9}, "whole: expected a whole number of 1 or more, found 0 (and 1 more)"),
        ({"wole": 1}, "unknown key 'wole': did you mean 'whole'?"),
        ({"wole": 1, "hcoice": 1}, "unknown key 'wole' (and 1 more): did you mean 'whole'?"),
        ({"part": SIZE | {"size": 1}}, "unknown key 'part.size': did you mean 'part.size_m'?"),
        ({"part": SIZE | {"colour": 1}}, "unknown key 'part.colour'; known here: size_m, corner"),
        ({"parts": [SIZE | {"size": 1}]}, "unknown key 'parts.0.size': did you mean 'parts.0.size_m'?"),
    ],
)
def test_mistakes_are_told_in_plain_words(tree: dict[str, Any], text: str) -> None:
    assert message(Everything, tree) == text


@pytest.mark.parametrize(
    ("key", "meant"),
    [
        ("detect3d.cluster.distance", "detect3d.cluster.distance_m"),
        ("detect3d.distance", "detect3d.cluster.distance_m"),
        ("detect3d.min_points", "detect3d.cluster.min_points"),
        ("detect3d.cluster_distance_m", "detect3d.cluster.distance_m"),
        ("synk", "sync"),
        ("sync.polcy", "sync.policy"),
        ("combine.ground.heigt_tolerance_m", "combine.ground.height_tolerance_m"),
        ("velodyne.topics./a.modle", "velodyne.topics./a.model"),
    ],
)
def test_the_key_that_was_meant(key: str, meant: str) -> None:
    *parents, leaf = key.replace("./a.", " /a ").replace(".", " ").split()
    tree: dict[str, Any] = {leaf: 1}
    for parent in reversed(parents):
        tree = {parent: tree}
    assert message(Config, tree) == f"unknown key {key!r}: did you mean {meant!r}?"


def test_a_key_unlike_all_others_gets_the_list() -> None:
    assert message(Config, {"sync": {"xyz": 1}}).startswith("unknown key 'sync.xyz'; known here: policy, reference, ")


def test_keys_that_are_no_names() -> None:
    tree: dict[Any, Any] = {1: 2}
    text = message(Everything, tree)
    assert text.startswith("expected a section with the keys flag, whole, ")
    assert text.endswith(", found a section with the keys 1")


def test_the_error_is_the_one_that_is_asked_for() -> None:
    with pytest.raises(CalibrationError, match=r"^here: flag"):
        checked(Everything, {"flag": 3}, "here", CalibrationError)


def test_no_word_of_the_library_whatever_is_wrong() -> None:
    told = mistakes(Config, lambda tree: checked(Config, tree, "file"))
    assert len(told) > 500
    assert not words_of_the_library(told)
    elsewhere = [(key, text) for key, text in told if key not in text and not re.search("unknown|finite|missing", text)]
    assert not elsewhere


NUMBERS = [key for key, place in key_places(Config) if {int, float} & {one.annotation for one in place.members}]


@pytest.mark.parametrize("number", [1e300, -1e300, float("nan"), float("inf"), 10**5000, -(10**5000)], ids=range(6))
def test_no_setting_takes_a_number_that_cannot_be_reckoned_with(number: float) -> None:
    keys = [key for key in NUMBERS if "*" not in key]
    assert len(keys) > 70
    for key in keys:
        tree: dict[str, Any] = {}
        set_values(tree, {key: number})
        assert message(Config, tree).startswith(f"{key}: expected ")
