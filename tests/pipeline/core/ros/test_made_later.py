from collections.abc import Callable
from functools import partial

import pytest

from pipeline.core.ros.made_later import MadeLater

READS: list[Callable[[MadeLater[int]], object]] = [
    lambda made: made["later"],
    lambda made: made.get("later"),
    lambda made: dict(made)["later"],
    lambda made: {**made}["later"],
    lambda made: ({} | made)["later"],
    lambda made: dict(made.items())["later"],
    lambda made: list(made.values())[1],
    lambda made: MadeLater(made)["later"],
    lambda made: MadeLater(MadeLater(made), {"another": lambda: 0})["later"],
]


@pytest.mark.parametrize("read", READS)
def test_nothing_tells_that_a_value_was_not_there(read: Callable[[MadeLater[int]], object]) -> None:
    assert read(MadeLater({"here": 1}, {"later": lambda: 2})) == 2


def test_values_are_made_once_and_when_they_are_asked_for() -> None:
    made: list[str] = []

    def make(name: str) -> str:
        made.append(name)
        return name

    several = MadeLater({}, {name: partial(make, name) for name in ("a", "b")})
    assert "a" in several
    assert (list(several), len(several), made) == (["a", "b"], 2, [])
    assert [several["b"], several["b"]] == ["b", "b"]
    assert made == ["b"]


def test_what_is_not_there_is_not_there() -> None:
    assert MadeLater({}).get("x", 3) == 3
    with pytest.raises(KeyError, match="x"):
        MadeLater({})["x"]
