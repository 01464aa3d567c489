"""How a command ends: its exit code, the line that says why, and the same in JSON."""

import pytest

from lidcam.cli.verdict import Verdict, first_of
from lidcam.pipeline.core.errors import CheckError, IncompleteError


@pytest.mark.parametrize(
    ("verdict", "failure", "code", "error", "line"),
    [
        (Verdict(), "", 0, None, ""),
        (Verdict((), ["a"]), "", 3, IncompleteError, "a"),
        (Verdict((), [*"abcd"]), "", 3, IncompleteError, "a; b; c; d"),
        (Verdict((), [*"abcdef"]), "", 3, IncompleteError, "a; b; c; d; and 2 more"),
        (Verdict(("it failed", "twice"), ["a"]), "it failed; twice", 1, CheckError, "it failed; twice"),
    ],
)
def test_the_exit_code_and_the_line(
    verdict: Verdict, failure: str, code: int, error: type[Exception] | None, line: str
) -> None:
    assert verdict.tree() == {"failure": failure, "incomplete": [*verdict.incomplete], "exit_code": code}
    if error is None:
        verdict.end()
        return
    assert failure or first_of(verdict.incomplete) == line
    with pytest.raises(error, match=f"^{line}$"):
        verdict.end()
