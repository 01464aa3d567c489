"""Run all campaigns, or those named: `python tests/campaign/run_all.py [--minutes M] [--seed S] [NAME ...]`.

Each gets an equal share of the minutes. Ends with 1 where one fell short.
"""

import argparse
import subprocess
import sys
from pathlib import Path

FOLDER = Path(__file__).resolve().parent
NAMES = ("containers", "long_run", "signals", "stamps")


def main() -> int:
    """The exit code: 1 if any campaign fell short."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=30.0, help="in all (default: %(default)g)")
    parser.add_argument("--seed", type=int, default=1, help="of all chance (default: %(default)s)")
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(NAMES)} (default: all)")
    options = parser.parse_args()
    if unknown := set(options.names) - {*NAMES}:
        parser.error(f"no campaign is called {', '.join(sorted(unknown))}")
    names = options.names or NAMES
    share = [f"--minutes={options.minutes / len(names)}", f"--seed={options.seed}"]
    ended = [subprocess.run([sys.executable, FOLDER / f"{name}.py", *share], check=False).returncode for name in names]
    return int(any(ended))


if __name__ == "__main__":
    sys.exit(main())
