"""What the campaigns share; `make campaign` runs them."""

import time
from pathlib import Path
from random import Random

import pytest
from common import CaseTimeoutError, Outcome, campaign, is_one_line, run_child, time_limit


def test_faults_are_counted_kept_and_end_with_1(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def try_case(number: int, chance: Random) -> Outcome:
        if number == 2:
            raise KeyError("x")
        if number == 3:
            while True:
                pass
        is_fault = number == 1
        return Outcome("lost" if is_fault else "fine", is_fault, f"{chance.random()}", {"in.bin": b"a"})

    assert campaign("x", try_case, count=9, arguments=["--count", "5", "--out", str(tmp_path)], max_case_s=0.1) == 1
    printed = capsys.readouterr().out
    assert "5 cases" in printed
    assert printed.count("<- falls short") == 3
    assert (tmp_path / "x" / "case1" / "in.bin").read_bytes() == b"a"
    kept = [(tmp_path / "x" / f"case{number}" / "outcome.txt").read_text() for number in (2, 3)]
    assert kept[0].startswith("crash: KeyError")
    assert kept[1].startswith("hang")
    assert campaign("x", try_case, count=9, arguments=["--case", "4", "--out", str(tmp_path)]) == 0
    again = capsys.readouterr().out
    assert campaign("x", try_case, count=9, arguments=["--case", "4", "--out", str(tmp_path)]) == 0
    assert capsys.readouterr().out.splitlines()[0] == again.splitlines()[0]


def test_a_child_is_measured_and_ended() -> None:
    ended = run_child(["sh", "-c", "echo a; echo b >&2; exit 3"])
    assert (ended.returncode, ended.stdout, ended.stderr, ended.is_hung) == (3, "a\n", "b\n", False)
    assert not ended.has_traceback
    hung = run_child(["sleep", "60"], timeout_s=0.05)
    assert hung.is_hung
    assert hung.returncode == -9


def test_a_case_that_takes_too_long_is_interrupted() -> None:
    with time_limit(0.01), pytest.raises(CaseTimeoutError):
        time.sleep(10)


@pytest.mark.parametrize(("text", "expected"), [("", False), ("a\n", True), ("a\nb\n", False), ("a" * 6000, False)])
def test_one_line(text: str, expected: bool) -> None:
    assert is_one_line(text) is expected
