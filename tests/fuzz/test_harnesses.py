"""Every decoder holds to its contract (see `harnesses`): inputs that were found, and a few hundred alterations.

`make fuzz` tries thousands a second for minutes.
"""

import random
import sys

import pytest
from fuzz import MEASURED
from harnesses import CORPUS, HARNESSES, inputs
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

NUMBERS = [0, 1, 2, 127, 255, 256, 2**15, 2**16 - 1, 2**31 - 1, 2**31, 2**32 - 1, 2**63 - 1, 2**63, 2**64 - 1]


def altered(seed: bytes, number: int) -> bytes:
    """The seed with one to six places changed as damage and malice change them."""
    chance = random.Random(number)
    data = bytearray(seed)
    for _ in range(chance.randint(1, 6)):
        at = chance.randrange(len(data) + 1)
        other = chance.randrange(len(data) + 1)
        match chance.randrange(6):
            case 0:
                data[at : at + 1] = bytes([chance.randrange(256)])
            case 1:
                size = chance.choice((1, 2, 4, 8))
                data[at : at + size] = (chance.choice(NUMBERS) % 256**size).to_bytes(
                    size, chance.choice(("little", "big"))
                )
            case 2:
                del data[min(at, other) : max(at, other)]
            case 3:
                data[at:at] = data[other : other + chance.randrange(64)]
            case 4:
                del data[at:]
            case _:
                data[at:at] = chance.randbytes(chance.randrange(16))
    return bytes(data)


@pytest.mark.parametrize("name", HARNESSES)
def test_sound_inputs_and_such_that_were_found(name: str) -> None:
    for data in [b"", *inputs(name)]:
        HARNESSES[name].run(data)


@pytest.mark.slow
@pytest.mark.parametrize("name", HARNESSES)
def test_altered_inputs(name: str) -> None:
    harness = HARNESSES[name]
    seeds = inputs(name)

    @settings(max_examples=25, deadline=None, derandomize=True, database=None, suppress_health_check=[*HealthCheck])
    @given(st.sampled_from(range(len(seeds))), st.integers(0, 2**32))
    def hold(seed: int, number: int) -> None:
        harness.run(altered(seeds[seed], number))

    hold()


def test_the_corpus_is_small() -> None:
    files = [path for path in CORPUS.rglob("*") if path.is_file()]
    assert {path.parent.name for path in files} <= HARNESSES.keys()
    assert sum(path.stat().st_size for path in files) < 500_000


def test_what_guides_the_fuzzer_is_imported_by_these_names() -> None:
    assert {*MEASURED} <= sys.modules.keys()
