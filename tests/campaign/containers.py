"""Whole files of every container, altered at random, against what was in them: `python tests/campaign/containers.py`.

Each case alters a small recording (bits, bytes, a cut, zeroed and swapped and repeated sectors, inserted bytes, a piece
of another recording) and reads all of it. What is read has to be what was recorded, or the difference told, but for
bytes that no checksum covers.
"""

import sys
from random import Random

from common import Outcome, campaign  # isort: skip  (puts the tests' folders on the path)

from damage_judge import judge_altered
from sound_recordings import KINDS


def _try_case(number: int, chance: Random) -> Outcome:
    verdict, files = judge_altered(KINDS[number % len(KINDS)], chance)
    return Outcome(verdict.kind, verdict.is_fault, verdict.detail, files)


if __name__ == "__main__":
    sys.exit(campaign("containers", _try_case, count=50_000))
