"""`lidcam drive.bag`: a folder with all that there is to look at."""

from pathlib import Path

import pytest
from builders import write_mcap, write_rosbag1
from command import Lidcam
from helpers import CLUSTERS
from small_drive import small_drive

NAMES = ["drive.foxglove.json", "drive.html", "drive.mcap", "drive.rrd"]
PART = ("--set", CLUSTERS)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write_rosbag1(tmp_path / "drive.bag", small_drive("ros1", frames=3))
    return tmp_path


@pytest.mark.parametrize(
    ("command", "made"),
    [
        (("drive.bag",), "drive.lidcam"),
        (("process", "drive.bag"), "drive.lidcam"),
        (("./drive.bag", "-o", "results/first"), "results/first"),
    ],
)
def test_a_folder_of_results(lidcam: Lidcam, folder: Path, command: tuple[str, ...], made: str) -> None:
    for _ in range(2):  # the second replaces what the first wrote
        run = lidcam(*command, *PART, folder=folder)
        assert run.code == 0, run.err
        assert sorted(path.name for path in (folder / made).iterdir()) == NAMES
    assert f"to look at it: lidcam view {made}/drive.rrd (or .html, .mcap)" in run.out


def test_a_file_of_another_name(lidcam: Lidcam, folder: Path) -> None:
    assert lidcam("process", "drive.bag", "-o", "out.mcap", *PART, folder=folder).code == 0
    assert sorted(path.name for path in folder.iterdir()) == ["drive.bag", "out.foxglove.json", "out.mcap"]


def test_a_run_that_fails_leaves_no_folder(lidcam: Lidcam, folder: Path) -> None:
    for output in ((), ("-o", "new/results/first")):
        assert lidcam("drive.bag", *output, "--start", "1000", folder=folder).code == 1
    assert [path.name for path in folder.iterdir()] == ["drive.bag"]


def test_a_result_is_no_recording(lidcam: Lidcam, folder: Path) -> None:
    assert lidcam("process", "drive.bag", "-o", "out.mcap", *PART, folder=folder).code == 0
    again = lidcam("out.mcap", folder=folder)
    assert again.code == 2
    assert "out.mcap is a result of lidcam: `lidcam view out.mcap` opens it" in " ".join(again.err.split())
    assert lidcam("drive.bag", *PART, folder=folder).code == 0
    inside = lidcam("drive.lidcam", folder=folder)
    assert inside.code == 2
    assert "drive.lidcam is a result of lidcam" in " ".join(inside.err.split())
    both = lidcam("process", "drive.bag", "out.mcap", "-o", "other", folder=folder)
    assert both.code == 2
    assert "names the output, and so does out.mcap" in " ".join(both.err.split())
    for inspected in ("out.mcap", "drive.lidcam"):
        assert "is a result of lidcam: see lidcam view" in lidcam("inspect", inspected, folder=folder).out


def test_a_folder_that_one_stands_in(lidcam: Lidcam, folder: Path) -> None:
    (folder / "a run").mkdir()
    write_mcap(folder / "a run" / "part_0.mcap", small_drive("cdr", frames=3))
    run = lidcam(".", *PART, folder=folder / "a run")
    assert run.code == 0, run.err
    assert (folder / "a run.lidcam" / "a run.mcap").is_file()
    assert f"lidcam view '{folder / 'a run.lidcam' / 'a run.rrd'}'" in run.out
