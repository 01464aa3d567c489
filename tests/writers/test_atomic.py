import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from pipeline.core.errors import OutputError
from writers.atomic import atomic_output


def names_in(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def write_half(path: Path, error: type[BaseException]) -> None:
    with atomic_output(path) as part:
        part.write_bytes(b"half")
        raise error


def test_the_target_appears_when_the_block_ends(tmp_path: Path) -> None:
    target = tmp_path / "out.mcap"
    with atomic_output(target) as part:
        part.write_bytes(b"whole")
        assert part == tmp_path / "out.mcap.part"
        assert not target.exists()
    assert target.read_bytes() == b"whole"
    assert names_in(tmp_path) == ["out.mcap"]


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt, SystemExit])
def test_a_failure_leaves_the_older_file_and_nothing_else(tmp_path: Path, error: type[BaseException]) -> None:
    target = tmp_path / "out.mcap"
    target.write_bytes(b"older")
    with pytest.raises(error):
        write_half(target, error)
    assert target.read_bytes() == b"older"
    assert names_in(tmp_path) == ["out.mcap"]


def test_a_link_stays_and_its_file_is_replaced(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"older")
    (tmp_path / "link").symlink_to("file")
    with atomic_output(tmp_path / "link") as part:
        part.write_bytes(b"whole")
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "file").read_bytes() == b"whole"


def make_fifo(folder: Path) -> Path:
    os.mkfifo(folder / "pipe")
    return folder / "pipe"


@pytest.mark.parametrize(
    ("make", "expected"),
    [
        (lambda folder: folder / "no" / "out.mcap", "there is no folder .*create it"),
        (lambda folder: folder, "is a directory"),
        (make_fifo, "not a regular file"),
        (lambda folder: folder / ("x" * 300), "cannot be written"),
        (lambda _: Path("/proc/out.mcap"), "cannot be written|no folder"),
    ],
    ids=["missing folder", "directory", "fifo", "name too long", "not writable"],
)
def test_an_unusable_target_is_one_clear_line(tmp_path: Path, make: Callable[[Path], Path], expected: str) -> None:
    path = make(tmp_path)
    before = names_in(tmp_path)
    with pytest.raises(OutputError, match=expected) as caught, atomic_output(path):
        pytest.fail("the block must not run")
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)
    assert names_in(tmp_path) == before


def test_a_killed_run_leaves_no_file_of_that_name(tmp_path: Path) -> None:
    code = (
        "import sys, time; from pathlib import Path; from writers.atomic import atomic_output\n"
        "with atomic_output(Path(sys.argv[1])) as part:\n"
        "    part.write_bytes(b'half'); print('writing', flush=True); time.sleep(60)\n"
    )
    target = tmp_path / "out.mcap"
    root = Path(__file__).resolve().parents[2]
    with subprocess.Popen([sys.executable, "-c", code, str(target)], stdout=subprocess.PIPE, cwd=root) as run:
        assert run.stdout is not None
        assert run.stdout.readline() == b"writing\n"
        run.send_signal(signal.SIGKILL)
    assert names_in(tmp_path) == ["out.mcap.part"]
    with atomic_output(target) as part:
        part.write_bytes(b"whole")
    assert names_in(tmp_path) == ["out.mcap"]
