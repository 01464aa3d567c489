"""Prints the tests of what changed since the branch left `main`: `python tests/support/changed_tests.py`.

Tests mirror the sources: those of `pipeline/stages/fuse.py` are `tests/pipeline/stages/test_fuse.py`, or that folder.
"""

import subprocess
from collections.abc import Iterable
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
ALWAYS = "tests/test_architecture.py"


def mirrored_tests(changed: Iterable[str]) -> list[str]:
    """Test files and folders of changed files; all are paths relative to the repository."""
    found = {ALWAYS} | {test for path in changed if path.endswith(".py") and (test := _test_of(Path(path)))}
    return sorted(test for test in found if not any(str(parent) in found for parent in Path(test).parents))


def _test_of(path: Path) -> str:
    if path.parts[0] == "tests":
        return str(path) if path.name.startswith("test_") and (ROOT / path).exists() else ""
    mirrored = Path("tests", path.parent, f"test_{path.name}")
    for test in (mirrored, *mirrored.parents):
        if (ROOT / test).exists() and len(test.parts) > 2:
            return str(test)
    return ""


def _git(*arguments: str) -> str:
    return subprocess.run(["git", *arguments], cwd=ROOT, capture_output=True, text=True, check=False).stdout


def main() -> None:
    """Print them, in a line."""
    base = _git("merge-base", "HEAD", "origin/main").strip() or "HEAD"
    names = _git("diff", "--name-only", base) + _git("ls-files", "--others", "--exclude-standard")
    print(*mirrored_tests(names.splitlines()))


if __name__ == "__main__":
    main()
