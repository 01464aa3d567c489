"""Encoding leaves the thread as it was."""

import os
import sys

import pytest
from video import CODECS, encode, moving


@pytest.mark.skipif(not hasattr(os, "sched_getscheduler"), reason=f"{sys.platform} tells of no scheduling")
@pytest.mark.parametrize("kind", CODECS)
def test_no_encoder_takes_the_processor_from_all_others(kind: str) -> None:
    before = os.sched_getscheduler(0)
    assert encode(moving(1), kind)
    assert os.sched_getscheduler(0) == before
