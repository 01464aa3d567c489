"""Text from outside in one line, and records in short."""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import pytest

from lidcam.pipeline.core.text import brief, one_line, visible


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


@dataclass(frozen=True)
class Inner:
    values: Any

    __repr__ = brief


@dataclass(frozen=True)
class Outer:
    name: str
    inner: Any


class Pair(NamedTuple):
    stamp_ns: int
    data: bytes


@pytest.mark.parametrize(
    ("record", "text"),
    [
        (Inner(np.zeros((0, 3))), "Inner(values=float64[0, 3])"),
        (Inner(np.zeros((12, 3), np.float32)), "Inner(values=float32[12, 3])"),
        (Inner(b"\0" * 1000), "Inner(values=<1000 bytes>)"),
        (Inner(()), "Inner(values=())"),
        (Inner((1, 2, 3, 4)), "Inner(values=(1, 2, 3, ...))"),
        (Inner({"a": np.zeros(2)}), "Inner(values={'a': float64[2]})"),
        (Inner(None), "Inner(values=None)"),
        (Outer("x", Inner(np.zeros(3))), "Outer(name='x', inner=Inner(values=float64[3]))"),
        (Outer("x", Outer("y", Outer("z", 1))), "Outer(name='x', inner=Outer(name='y', inner=Outer(...)))"),
        (Pair(5, b"abc"), "Pair(stamp_ns=5, data=<3 bytes>)"),
    ],
)
def test_what_is_shown(record: Any, text: str) -> None:
    assert brief(record) == text
