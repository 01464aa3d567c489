"""What the garbage collector looks at."""

import subprocess
import sys

PROGRAM = """
import atexit, gc
atexit.register(lambda: print(gc.get_freeze_count() > 1000))  # called behind those that are registered later
from pipeline.core.garbage import LATE_OBJECTS, collect_late, keep_objects
usual = gc.get_threshold()
collect_late()
print(gc.get_threshold()[0] == LATE_OBJECTS, gc.get_freeze_count() == 0)
keep_objects()
print(gc.get_threshold() == usual, gc.get_freeze_count() > 1000)
gc.unfreeze()
"""


def test_garbage_is_looked_for_late_then_as_usual_and_not_when_the_program_ends() -> None:
    run = subprocess.run([sys.executable, "-c", PROGRAM], check=True, capture_output=True, text=True)
    assert run.stdout.split() == ["True"] * 5
