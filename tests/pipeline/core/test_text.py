"""Text from outside in one line."""

import pytest

from pipeline.core.text import one_line, visible


@pytest.mark.parametrize(
    ("found", "expected"),
    [("", ""), ("one", "one"), (" a\n\tb  c\r\n", "a b c"), (ValueError("a\nb"), "a b"), (None, "None")],
)
def test_one_line(found: object, expected: str) -> None:
    assert one_line(found) == expected
    assert one_line(found, max_characters=3) == expected[:3]


@pytest.mark.parametrize(
    ("text", "expected"),
    [("", ""), ("Größe 1 m", "Größe 1 m"), ("a\x1b[2Jb", r"a\x1b[2Jb"), ("a\n\u202eb\udc80", r"a\n\u202eb\udc80")],
)
def test_visible(text: str, expected: str) -> None:
    assert visible(text) == expected
