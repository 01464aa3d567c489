"""Printing to terminals, pipes and files."""

import pytest

from lidcam.printing.terminal import console


def test_text_is_printed_as_it_is(capsys: pytest.CaptureFixture[str]) -> None:
    line = "/topic[bold] :smile: " + 30 * "long "
    console().print(line)
    assert capsys.readouterr().out == line + "\n"
