"""What the campaigns share; `make campaign` runs them."""

import signal
from pathlib import Path
from random import Random

import pytest
from common import CaseTimeoutError, Outcome, campaign, run_child, time_limit


def test_faults_are_counted_kept_and_end_with_1(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def try_case(number: int, chance: Random) -> Outcome:
        if number > 1:
            raise (KeyError("x") if number == 2 else CaseTimeoutError("took too long"))
        return Outcome("lost" if number else "fine", number == 1, f"{chance.random()}", {"in.bin": b"a"})

    def run(*arguments: str) -> tuple[int, str]:
        code = campaign("x", try_case, count=9, arguments=[*arguments, "--out", str(tmp_path)])
        return code, capsys.readouterr().out

    code, printed = run("--count", "4")
    assert (code, "4 cases" in printed, printed.count("<- falls short")) == (1, True, 3)
    assert (tmp_path / "x" / "case1" / "in.bin").read_bytes() == b"a"
    kept = [(tmp_path / "x" / f"case{number}" / "outcome.txt").read_text() for number in (2, 3)]
    assert [text.splitlines()[0] for text in kept] == ["crash: KeyError", "hang"]
    assert run("--case", "0")[1].splitlines()[0] == run("--case", "0")[1].splitlines()[0]


def test_a_child_is_measured_and_ended() -> None:
    ended = run_child(["sh", "-c", "echo a; echo b >&2; exit 3"])
    assert (ended.returncode, ended.stdout, ended.stderr, ended.is_hung) == (3, "a\n", "b\n", False)
    assert not ended.has_traceback
    hung = run_child(["sleep", "600"], timeout_s=0.05)
    assert (hung.is_hung, hung.returncode) == (True, -9)


def test_a_case_that_takes_too_long_is_interrupted() -> None:
    with pytest.raises(CaseTimeoutError), time_limit(0.01):
        signal.pause()
