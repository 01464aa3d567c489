from pathlib import Path
from typing import Annotated, Any, Literal

import pytest
from pydantic import Field

from lidcam.pipeline.core.errors import CalibrationError, ConfigError
from lidcam.pipeline.core.geometry.pose_samples import MAX_GAP_NS
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.core.settings.model import Count, Positive, SettingsModel
from lidcam.pipeline.core.settings.validation import checked


def message(model: type[SettingsModel], tree: dict[Any, Any]) -> str:
    with pytest.raises(ConfigError) as caught:
        checked(model, tree, "file")
    text = str(caught.value)
    assert text.startswith("file: ")
    assert caught.value.__cause__ is None
    return text.removeprefix("file: ")


class Part(SettingsModel):
    size_m: tuple[Positive, Positive, Positive]


class Everything(SettingsModel):
    flag: bool = True
    whole: Count = 1
    number: Annotated[float, Field(gt=0, lt=90)] = 1.0
    optional: Positive | None = None
    path: Path | None = None
    choice: Literal["a", "b"] = "a"
    topics: tuple[str, ...] = ()
    named: dict[str, Part] = Field(default_factory=dict)
    parts: Annotated[list[Part], Field(min_length=1)] = [Part(size_m=(1, 1, 1))]  # noqa: RUF012  # pydantic copies it
    either: Literal["all"] | tuple[str, ...] = "all"
    pair: Literal["auto"] | tuple[int, int] = "auto"
    code: Annotated[str, Field(pattern="^[a-z]+$")] = "a"
    part: Part = Part(size_m=(1, 1, 1))


SIZE = {"size_m": [1, 1, 1]}


@pytest.mark.parametrize(
    ("tree", "text"),
    [
        ({"flag": "maybe"}, "flag: expected true or false, found 'maybe'"),
        ({"flag": {}}, "flag: expected true or false, found an empty section"),
        ({"flag": {"a": 1, "b": 2}}, "flag: expected true or false, found a section with the keys a, b"),
        ({"flag": ["x" * 500]}, f"flag: expected true or false, found [{'x' * 119}..."),
        ({"flag": object}, "flag: expected true or false, found <class 'object'>"),
        ({"whole": 0}, "whole: expected at least 1, found 0"),
        ({"whole": 1.5}, "whole: expected a whole number, found 1.5"),
        ({"whole": None}, "whole: expected a whole number, found null"),
        ({"number": 90}, "number: expected below 90, found 90"),
        ({"number": float("inf")}, "number: expected a finite number, found .inf"),
        ({"optional": 1e300}, "optional: expected at most 9000000000, found 1.0e+300"),
        ({"optional": "x"}, "optional: expected a number, found 'x'"),
        ({"choice": True}, "choice: expected 'a' or 'b', found true"),
        ({"topics": "/a"}, "topics: expected a list, found '/a'"),
        ({"topics": [1]}, "topics.0: expected text, found 1"),
        ({"named": []}, "named: expected a section, found []"),
        ({"named": {"a": 3}}, "named.a: expected a section, found 3"),
        ({"named": {"a": {}}}, "named.a.size_m is missing"),
        ({"parts": []}, "parts: expected a list with at least 1 item, found []"),
        ({"parts": [{"size_m": [1]}]}, "parts.0.size_m.1 is missing (and 1 more)"),
        ({"parts": [{"size_m": [1, 2, 0]}]}, "parts.0.size_m.2: expected above 0, found 0"),
        ({"either": 5}, "either: expected 'all' or a list, found 5"),
        ({"pair": [1]}, "pair: expected 'auto' or a longer list, found [1]"),
        ({"pair": [1, 2, 3]}, "pair: expected 'auto' or a list with at most 2 items, found [1, 2, 3]"),
        ({"code": "A"}, "code: expected text of the form '^[a-z]+$', found 'A'"),
        ({"whole": 0, "number": 99}, "whole: expected at least 1, found 0 (and 1 more)"),
        ({"wole": 1}, "unknown key 'wole': did you mean 'whole'?"),
        ({"wole": 1, "hcoice": 1}, "unknown key 'wole' (and 1 more): did you mean 'whole'?"),
        ({"part": SIZE | {"size": 1}}, "unknown key 'part.size': did you mean 'part.size_m'?"),
        ({"part": SIZE | {"colour": 1}}, "unknown key 'part.colour'; known here: size_m"),
        ({"parts": [SIZE | {"size": 1}]}, "unknown key 'parts.0.size': did you mean 'parts.0.size_m'?"),
    ],
)
def test_mistakes_are_one_line_with_key_expected_and_found(tree: dict[str, Any], text: str) -> None:
    assert message(Everything, tree) == text


@pytest.mark.parametrize(
    ("key", "meant"),
    [
        ("detect3d.cluster.distance", "detect3d.cluster.distance_m"),
        ("detect3d.distance", "detect3d.cluster.distance_m"),
        ("detect3d.min_points", "detect3d.cluster.min_points"),
        ("detect3d.cluster_distance_m", "detect3d.cluster.distance_m"),
        ("synk", "sync"),
        ("slop_s", "sync.slop_s"),
        ("sync.slop", "sync.slop_s"),
        ("combine.ground.heigt_tolerance_m", "combine.ground.height_tolerance_m"),
    ],
)
def test_the_key_that_was_meant(key: str, meant: str) -> None:
    *parents, leaf = key.split(".")
    tree: dict[str, Any] = {leaf: 1}
    for parent in reversed(parents):
        tree = {parent: tree}
    assert message(Config, tree) == f"unknown key {key!r}: did you mean {meant!r}?"


@pytest.mark.parametrize(
    ("tree", "text"),
    [
        ({"fuse": {"cabin": 0.3}}, "fuse.cabin is gone: now a constant of 0.4"),
        ({"combine": {"motion": {"max_gap_s": 2}}}, f"max_gap_s is gone: now a constant of {MAX_GAP_NS / 1e9:g}$"),
        ({"compare": {"gate": 2}}, "compare is gone: now constants of"),
        ({"limits": {"max_boxes": 3}}, "limits is gone: use limit_scale, which multiplies all limits"),
        ({"associate": {"gate": 3}}, "associate is gone: now constants of pipeline/core/association.py"),
        ({"run": {"window": 3, "x": 1}}, "run.window is gone: now two frames per process .* use run.workers"),
    ],
)
def test_settings_of_earlier_versions(tree: dict[str, Any], text: str) -> None:
    with pytest.raises(ConfigError, match=text):
        checked(Config, tree, "file")


def test_a_key_unlike_all_others_gets_the_list() -> None:
    assert message(Config, {"sync": {"xyz": 1}}).startswith("unknown key 'sync.xyz'; known here: reference, ")


def test_the_error_is_the_one_that_is_asked_for() -> None:
    with pytest.raises(CalibrationError, match=r"^here: flag"):
        checked(Everything, {"flag": 3}, "here", CalibrationError)
