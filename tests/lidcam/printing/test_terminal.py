"""Progress and printing on terminals and elsewhere."""

import io

import pytest
from rich.console import Console

from lidcam.printing.terminal import console, progress_bar


@pytest.mark.parametrize("is_terminal", [True, False])
def test_progress_is_shown_on_terminals_only(is_terminal: bool) -> None:
    text = io.StringIO()
    with progress_bar(Console(file=text, force_terminal=is_terminal, width=80), 4.0) as advance:
        advance(2.5)
    assert ("2.5 of 4.0 s" in text.getvalue()) == is_terminal


def test_text_is_printed_as_it_is(capsys: pytest.CaptureFixture[str]) -> None:
    line = "/topic[bold] :smile: " + 30 * "long "
    console().print(line)
    assert capsys.readouterr().out == line + "\n"
