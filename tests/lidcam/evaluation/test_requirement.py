"""Requirements on figures."""

from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lidcam.evaluation.figures import NamedFigures
from lidcam.evaluation.requirement import OPERATORS, Requirement, RequirementError, check_names, read_requirements
from lidcam.pipeline.evaluation.evaluation_frame import Figures

TREE: dict[str, Any] = {
    "sources": {
        "fused": {
            "car": {"recall": 0.84, "exact": 0.9, "truth": 12, "found": 10, "name": "x", "close": 0.89999999},
            "bus": {"recall": None, "truth": 0, "found": 1},
            "van": {"precision": None, "truth": 3, "found": 0, "errors": {"z_m": {"mean": None}}},
            "all": {"nds": None},
        }
    },
    "frames": 20,
}
FIGURES = NamedFigures(TREE)


@pytest.mark.parametrize(
    ("text", "requirement"),
    [
        ("fused.car.recall >= 0.9", Requirement("fused.car.recall", ">=", 0.9)),
        ("  frames   ==  20 ", Requirement("frames", "==", 20)),
        ("sources.fused.traffic cone.recall != -1e-3", Requirement("sources.fused.traffic cone.recall", "!=", -0.001)),
        ("a<=1", Requirement("a", "<=", 1)),
    ],
)
def test_a_requirement_is_read(text: str, requirement: Requirement) -> None:
    assert Requirement.parse(text) == requirement


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", "expected a figure, a comparison and a number, as in 'fused.car.ap_bev_r40_50 >= 0.9', found ''"),
        ("fused.car.recall", "expected a figure, a comparison and a number"),
        ("a = 0.9", "'a = 0.9': expected one of >=, <=, ==, !=, >, <, found '='"),
        ("a >= high", "'a >= high': expected a number after >=, found 'high'"),
        ("a >= inf", "expected a number after >=, found 'inf'"),
        ("a >= 90%", "expected a number after >=, found '90%'; shares are numbers from 0 to 1"),
    ],
)
def test_what_is_no_requirement(text: str, told: str) -> None:
    with pytest.raises(RequirementError) as raised:
        Requirement.parse(text)
    assert told in str(raised.value)


@pytest.mark.parametrize(
    ("text", "failure"),
    [
        ("fused.car.recall >= 0.84", ""),
        ("fused.car.recall >= 0.9", "fused.car.recall: expected >= 0.9, found 0.84"),
        ("fused.car.close >= 0.9", "fused.car.close: expected >= 0.9, found 0.89999999"),
        ("fused.car.exact != 0.9", "fused.car.exact: expected != 0.9, found 0.9"),
        (
            "fused.bus.recall >= 0",
            "fused.bus.recall: expected >= 0, found that it is not defined: there is no truth of it",
        ),
        (
            "fused.van.precision > 0",
            "fused.van.precision: expected > 0, found that it is not defined: nothing of it was found",
        ),
        ("fused.car.name > 0", "fused.car.name: expected > 0, found the text 'x'"),
    ],
)
def test_a_requirement_is_met_or_not(text: str, failure: str) -> None:
    assert Requirement.parse(text).check(FIGURES).failure == failure


@pytest.mark.parametrize("tree", [{"frames": 3}, {"frames": 3, "tracking": {}}])
def test_without_tracks_no_other_figure_is_offered(tree: Figures) -> None:
    outcome = Requirement.parse("tracking.fused.car.hota > 0.5").check(NamedFigures(tree))
    assert outcome.failure == (
        "tracking.fused.car.hota: expected > 0.5, found no tracks: result and truth need ids of tracks"
    )


def test_a_figure_that_there_is_not_fails() -> None:
    outcome = Requirement.parse("fused.car.recal >= 0.1").check(FIGURES)
    assert outcome.failure.startswith(
        "fused.car.recal: expected >= 0.1, found no such figure: did you mean 'fused.car.recall'"
    )
    assert outcome.tree() == {
        "figure": "fused.car.recal",
        "comparison": ">=",
        "limit": 0.1,
        "found": None,
        "is_met": False,
    }


@given(st.floats(allow_nan=False, allow_infinity=False), st.floats(-10, 10), st.sampled_from(sorted(OPERATORS)))
def test_what_fails_is_told_with_a_number_that_fails_too(found: float, limit: float, sign: str) -> None:
    outcome = Requirement("a", sign, limit).check(NamedFigures({"a": found}))
    assert bool(outcome.failure) != OPERATORS[sign](found, limit)
    if outcome.failure and sign not in {"!=", ">", "<"}:
        assert not OPERATORS[sign](float(outcome.failure.rpartition("found ")[2]), limit)


def test_names_that_there_cannot_be_are_told_before() -> None:
    later = [
        "fused.car.labels.van.recall > 0",
        "tracking.fused.car.hota > 0",
        "fused.car.calibration.reliability.3.count > 0",
    ]
    check_names(read_requirements([*later, "fused.car.recall > 0", "frames > 0"]), FIGURES)
    with pytest.raises(RequirementError, match=r"unknown figure 'fused.car.recal': did you mean 'fused.car.recall'"):
        check_names(read_requirements(["frames > 0", "fused.car.recal > 0"]), FIGURES)


def test_a_file_of_requirements(tmp_path: Path) -> None:
    file = tmp_path / "gate.txt"
    file.write_text("# what we promise\n\nfused.car.recall >= 0.8  # measured 0.84\nframes > 10\n", encoding="utf-8")
    assert read_requirements([f"@{file}", "frames < 30"]) == (
        Requirement("fused.car.recall", ">=", 0.8),
        Requirement("frames", ">", 10),
        Requirement("frames", "<", 30),
    )
    assert read_requirements([]) == ()


@pytest.mark.parametrize(
    ("content", "told"),
    [
        (b"", "gate.txt: expected at least one requirement, as 'fused.car.ap_bev_r40_50 >= 0.9', found none"),
        (b"a > 1\nb = 2\n", "gate.txt, line 2: 'b = 2': expected one of"),
        (b"\xff\xfe", "expected requirements as UTF-8 text, found other bytes at 0"),
        (None, "gate.txt: expected requirements, found no such file"),
    ],
)
def test_a_file_that_is_no_good(content: bytes | None, told: str, tmp_path: Path) -> None:
    file = tmp_path / "gate.txt"
    if content is not None:
        file.write_bytes(content)
    with pytest.raises(RequirementError) as raised:
        read_requirements([f"@{file}"])
    assert told in str(raised.value)
    assert "gate.txt" in str(raised.value)
