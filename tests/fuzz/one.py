"""Fuzz one decoder with atheris: `python tests/fuzz/one.py NAME [options of libFuzzer] [folders of inputs]`."""

import sys
from pathlib import Path

import atheris

TESTS = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(TESTS.parent), str(TESTS / "support"), str(TESTS / "fuzz")]


def main() -> None:
    """Runs until libFuzzer ends it."""
    name = sys.argv.pop(1)
    with atheris.instrument_imports(include=["readers", "pipeline", "rosbags", "mcap"]):
        from harnesses import HARNESSES
    atheris.Setup(sys.argv, HARNESSES[name].run)
    atheris.Fuzz()


if __name__ == "__main__":
    main()
