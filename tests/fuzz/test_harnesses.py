"""Every decoder holds to its contract (see `harnesses`): inputs that were found, and a few hundred alterations.

`make fuzz` tries thousands a second for minutes.
"""

import sys
from random import Random

import pytest
from damage_judge import altered
from fuzz import MEASURED
from harnesses import CORPUS, HARNESSES, inputs
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st


@pytest.mark.parametrize("name", HARNESSES)
def test_sound_inputs_and_such_that_were_found(name: str) -> None:
    for data in [b"", *inputs(name)]:
        HARNESSES[name].run(data)


@pytest.mark.slow
@pytest.mark.parametrize("name", HARNESSES)
def test_altered_inputs(name: str) -> None:
    harness = HARNESSES[name]
    seeds = inputs(name)

    @settings(max_examples=35, deadline=None, derandomize=True, database=None, suppress_health_check=[*HealthCheck])
    @given(st.sampled_from(range(len(seeds))), st.integers(0, 2**32))
    def hold(seed: int, number: int) -> None:
        harness.run(altered(seeds[seed], Random(number))[0])

    hold()


def test_the_corpus_is_small() -> None:
    files = [path for path in CORPUS.rglob("*") if path.is_file()]
    assert {path.parent.name for path in files} <= HARNESSES.keys()
    assert sum(path.stat().st_size for path in files) < 500_000


def test_what_guides_the_fuzzer_is_imported_by_these_names() -> None:
    assert {*MEASURED} <= sys.modules.keys()
