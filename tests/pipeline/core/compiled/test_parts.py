"""What a compiled function uses, in its file and in others."""

import inspect
import sys
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from types import FunctionType, ModuleType
from typing import Any

import pytest

from pipeline.core.compiled import lane_types, lanes
from pipeline.core.compiled.parts import parts, used
from pipeline.filters.neighbor_search import mean_distances

SOURCES = {
    "others": """
from pipeline.core.compiled import compiled, compiled_as, inlined
from makers import make, names

SIX = 6

@inlined
def six():
    return SIX

@inlined
def twelve():
    return six() + six()

@compiled_as(lambda: make(names))
def made():
    return 1
""",
    "makers": "def make(them): return them\n\ndef names(): return []\n",
    "own": """
from others import SIX, made, six, twelve

NUMBERS = (1, 2.5)
TEXT = "text"

def alone(value): return [value, len(TEXT)]
def number(): return SIX
def within(): return [NUMBERS for _ in range(2)]
def direct(): return six()
def through(): return twelve()
def by(): return made()
def itself(): return itself() + direct()
""",
}


@pytest.fixture
def own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    for name, text in SOURCES.items():
        (tmp_path / f"{name}.py").write_text(text, encoding="utf-8")
        monkeypatch.delitem(sys.modules, name, raising=False)
    monkeypatch.syspath_prepend(tmp_path)
    return import_module("own")


@pytest.mark.parametrize(
    ("name", "numbers", "files"),
    [
        ("alone", "", []),
        ("number", "SIX=6", []),
        ("within", "NUMBERS=(1, 2.5)", []),
        ("direct", "SIX=6", ["others"]),
        ("through", "SIX=6", ["others"]),
        ("by", "", ["makers", "others"]),
        ("itself", "SIX=6", ["others"]),
    ],
)
def test_numbers_and_files(own: ModuleType, name: str, numbers: str, files: list[str]) -> None:
    expected = [*filter(None, [numbers.encode()]), *(SOURCES[file].encode() for file in files)]
    assert used(vars(own)[name]) == b"\0".join(expected)


def test_parts_are_functions(own: ModuleType) -> None:
    assert parts(own.itself) == {"itself": own.itself, "direct": own.direct}
    assert parts(own.number) == {}


def test_the_search_is_made_anew_with_its_vectors() -> None:
    search: Callable[..., Any] = inspect.unwrap(mean_distances)
    assert isinstance(search, FunctionType)
    for module in (lanes, lane_types):
        assert Path(inspect.getfile(module)).read_bytes() in used(search)
