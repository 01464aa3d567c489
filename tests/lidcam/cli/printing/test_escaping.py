"""What a terminal would obey is shown, wherever it comes from; what it shows anyhow stays as it is."""

import io
import json
import logging
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from logging_state import kept_logging
from rich.text import Text

from lidcam.cli.printing.escaping import json_text, visible, visible_lines
from lidcam.cli.printing.log import configure_logging, remark_log, verdict_log
from lidcam.cli.printing.tables import drops_table, objects_table, pairs_table
from lidcam.cli.printing.terminal import console, show_json, show_line, show_table
from lidcam.run.summary import DropCount

HOSTILE = "\x1b]52;c;ZQ==\x07\x9b2J\u202e\u200b\r\nlidcam: error: faked\b\x00[red]"
SHOWN = "\\x1b]52;c;ZQ==\\x07\\x9b2J\\u202e\\u200b\\r\\nlidcam: error: faked\\x08\\x00[red]"


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("", ""),
        ("/topic é 宽 [b]", "/topic é 宽 [b]"),
        (HOSTILE, SHOWN),
        ("a\tb", "a\\tb"),
        ("\u2028\xa0\xad\ud800\ufffe", "\\u2028\\xa0\\xad\\ud800\\ufffe"),
        ("\U000e0041", "\\U000e0041"),
    ],
)
def test_what_cannot_be_printed_is_escaped(text: str, shown: str) -> None:
    assert visible(text) == shown


@given(st.text(st.characters(), max_size=40))
def test_nothing_else_is_left(text: str) -> None:
    assert visible(text).isprintable()
    assert visible(visible(text)) == visible(text)
    lines = visible_lines(text)
    assert (lines.count("\n"), lines.count("\t")) == (text.count("\n"), text.count("\t"))
    assert lines.replace("\n", "").replace("\t", "").isprintable()


@given(st.recursive(st.text() | st.integers() | st.none(), lambda one: st.lists(one) | st.dictionaries(st.text(), one)))
def test_json_says_the_same_and_holds_nothing_that_a_terminal_obeys(tree: object) -> None:
    text = json_text(tree)
    assert json.loads(text) == tree
    assert text.replace("\n", "").isprintable()


@pytest.mark.parametrize("is_terminal", [False, True])
def test_a_console_lets_nothing_through(is_terminal: bool) -> None:
    out, file = console(), io.StringIO()
    out.file, out._force_terminal, out.no_color = file, is_terminal, True
    out.print(HOSTILE, highlight=False)
    out.print(Text(HOSTILE.replace("\n", "")), highlight=False)  # even what was not made visible before
    show_line(out, HOSTILE)
    show_table(out, pairs_table("", {HOSTILE: HOSTILE}))
    show_table(out, drops_table({HOSTILE: 1}, [DropCount(HOSTILE, HOSTILE, 2, HOSTILE)]))
    show_table(out, objects_table({(HOSTILE, HOSTILE): 1}, [HOSTILE], 1))
    show_json(out, {HOSTILE: HOSTILE})
    text = file.getvalue()
    if is_terminal:
        text = text.replace("\x1b[1m", "").replace("\x1b[2m", "").replace("\x1b[0m", "").replace("\x1b[22m", "")
    assert text.replace("\n", "").isprintable()
    assert not [line for line in text.splitlines() if line.startswith("lidcam: error: faked")] or is_terminal
    assert text.startswith(SHOWN)
    assert "[red]" in text


@pytest.fixture
def logging_as_it_was() -> Iterator[None]:
    with kept_logging():
        yield


@pytest.mark.usefixtures("logging_as_it_was")
def test_the_log_fakes_no_lines(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    configure_logging(log_file=tmp_path / "run.log")
    logging.getLogger("lidcam.processing").warning("%s", HOSTILE)
    logging.getLogger("lidcam.cli.program").error("%s", HOSTILE)
    remark_log.info("wrote %s", HOSTILE)
    verdict_log.warning("incomplete: %s", HOSTILE)
    try:
        int(HOSTILE)
    except ValueError:
        logging.getLogger("lidcam.cli.program").debug("a bug", exc_info=True)
    told = [f"lidcam: {SHOWN}", f"lidcam: error: {SHOWN}", f"wrote {SHOWN}", f"lidcam: incomplete: {SHOWN}"]
    assert capsys.readouterr().err.split("\n") == [*told, ""]
    log = (tmp_path / "run.log").read_text(encoding="utf-8")
    assert log.replace("\n", "").isprintable()
    assert log.count(SHOWN) == 5
    assert "ValueError" in log
