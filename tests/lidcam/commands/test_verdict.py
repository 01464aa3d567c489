"""How a command ends: its exit code, the line that says why, and the same in JSON."""

import pytest

from lidcam.commands.verdict import Verdict, first_of
from pipeline.core.errors import CheckError, IncompleteError


def test_nothing_is_missing() -> None:
    verdict = Verdict()
    verdict.end()
    assert verdict.tree() == {"failure": "", "incomplete": [], "exit_code": 0}


@pytest.mark.parametrize(
    ("reasons", "line"),
    [
        (["a"], "a"),
        (["a", "b", "c", "d"], "a; b; c; d"),
        (["a", "b", "c", "d", "e", "f"], "a; b; c; d; and 2 more"),
    ],
)
def test_something_is_missing(reasons: list[str], line: str) -> None:
    verdict = Verdict(incomplete=reasons)
    assert verdict.tree() == {"failure": "", "incomplete": reasons, "exit_code": 3}
    assert first_of(reasons) == line
    with pytest.raises(IncompleteError, match=f"^{line}$"):
        verdict.end()


def test_a_failure_counts_more() -> None:
    verdict = Verdict(("it failed", "twice"), ["a"])
    assert verdict.tree() == {"failure": "it failed; twice", "incomplete": ["a"], "exit_code": 1}
    with pytest.raises(CheckError, match=r"^it failed; twice$") as raised:
        verdict.end()
    assert raised.value.lines == ("it failed", "twice")
