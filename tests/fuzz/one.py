"""Fuzz one decoder: `python tests/fuzz/one.py guided|fast NAME [options of libFuzzer] [folders of inputs]`.

`guided` measures which branches an input takes and keeps those that take new ones; `fast` alters the inputs that it is
given without measuring, six times as many in a second.
"""

import sys
from pathlib import Path

import atheris

TESTS = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(TESTS.parent), str(TESTS / "support"), str(TESTS / "fuzz")]


def main() -> None:
    """Runs until libFuzzer ends it."""
    way, name = sys.argv.pop(1), sys.argv.pop(1)
    measured = ["readers", "pipeline", "rosbags", "mcap"] if way == "guided" else ["none"]
    with atheris.instrument_imports(include=measured):
        from harnesses import HARNESSES
    run = HARNESSES[name].run
    if way == "fast":  # libFuzzer does not begin without a single branch to measure
        run = atheris.instrument_func(lambda data: HARNESSES[name].run(data) if data else None)
    atheris.Setup(sys.argv, run)
    atheris.Fuzz()


if __name__ == "__main__":
    main()
