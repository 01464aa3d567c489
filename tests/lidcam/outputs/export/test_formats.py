"""The formats that the command offers are those that there are."""

from typing import get_args

from lidcam.cli.export import FormatName
from lidcam.outputs.export.formats import FORMATS


def test_the_command_offers_all_formats() -> None:
    assert list(get_args(FormatName)) == [*FORMATS]
