"""Text is printed as it is; tables and remarks are as wide as they are in pipes, and folded on terminals."""

import io
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.cells import cell_len
from rich.console import Console

from lidcam.cli.printing.tables import drops_table
from lidcam.cli.printing.terminal import folded_lines, show_line, show_table
from lidcam.run.summary import DropCount

TOPIC = "/car1/left_front_wheel_velocity_controller/command"
REASON = "no set of messages of every topic within sync.max_interval_s"


def terminal(width: int) -> Console:
    return Console(file=io.StringIO(), force_terminal=True, no_color=True, width=width, soft_wrap=True, markup=False)


def pipe() -> Console:
    return Console(file=io.StringIO(), force_terminal=False, width=20, soft_wrap=True, markup=False)


def printed(out: Console) -> list[str]:
    assert isinstance(out.file, io.StringIO)
    text = out.file.getvalue()
    return [line.rstrip() for line in re.sub(r"\x1b\[\dm", "", text).splitlines()]


@pytest.mark.parametrize(
    ("text", "width", "lines"),
    [
        ("", 10, [""]),
        ("left out: cam11", 10, ["left out:", "  cam11"]),  # after a blank
        ("/velodyne1/points", 12, ["/velodyne1/", "  points"]),  # after a mark
        ("a /velodyne1", 12, ["a /velodyne1"]),
        ("/image/compressed", 10, ["/image/", "compressed"]),  # rather without an indent than broken
        ("x" * 25, 10, ["x" * 10, "  " + "x" * 8, "  " + "x" * 7]),
        ("  two  blanks", 80, ["  two  blanks"]),
    ],
)
def test_folds_after_blanks_and_marks(text: str, width: int, lines: list[str]) -> None:
    assert list(folded_lines(text, width)) == lines


@given(st.text(st.sampled_from("ab宽é/_ .:"), max_size=60), st.integers(6, 40))
def test_no_letter_is_lost_and_no_line_too_long(text: str, width: int) -> None:
    lines = list(folded_lines(text, width))
    assert all(cell_len(line) <= width for line in lines)
    assert "".join("".join(lines).split()) == "".join(text.split())


@pytest.mark.parametrize("width", [60, 80, 100])
def test_a_table_fits_the_terminal_and_no_number_is_broken(width: int) -> None:
    out = terminal(width)
    show_table(out, drops_table({TOPIC: 1_234_567}, [DropCount(TOPIC, REASON, 7_654_321, "")]))
    lines = printed(out)
    assert all(len(line) <= width for line in lines)
    (first,) = (line for line in lines if "1234567" in line)
    assert "7654321" in first
    assert first.startswith("/car1/")
    assert "".join(TOPIC.split()) in "".join(line[: line.find("  ", 3)].strip() for line in lines[2:]).replace(" ", "")


@pytest.mark.parametrize(("out", "count"), [(terminal(30), 2), (pipe(), 1)])
def test_remarks(out: Console, count: int) -> None:
    show_line(out, f"note: {TOPIC}", "dim")
    assert len(printed(out)) == count
    assert "".join(line.strip() for line in printed(out)).replace(" ", "") == f"note:{TOPIC}"
