import os
from pathlib import Path

import pytest
from builders import write_mcap
from small_drive import small_drive

from lidcam.batches.jobs import find_jobs
from lidcam.pipeline.core.errors import RecordingError
from lidcam.readers.location import RemotePath


@pytest.fixture
def logs(tmp_path: Path) -> Path:
    """Two days: a recording, a ROS 2 folder, one that was split into three, and one with the number that follows."""
    logs = tmp_path / "logs"
    for day in ("day1", "day2", "day10"):
        (logs / day).mkdir(parents=True)
    (logs / "day1" / "a.bag").write_bytes(b"1")
    (logs / "day1" / "notes.txt").write_bytes(b"")
    (logs / "day2" / "bag").mkdir()
    (logs / "day2" / "bag" / "metadata.yaml").write_bytes(b"")
    (logs / "day2" / "bag" / "bag_0.db3").write_bytes(b"22")
    messages = small_drive("cdr", frames=9)
    third = len(messages) // 3
    for number in range(3):
        write_mcap(logs / "day10" / f"c_{number}.mcap", messages[number * third : (number + 1) * third])
    later = [one._replace(log_time_ns=one.log_time_ns + 10**12) for one in messages]
    write_mcap(logs / "day10" / "c_3.mcap", later)
    return logs


def names(given: list[object], out: Path) -> list[str]:
    return [job.name for job in find_jobs([*map(str, given)], out)]


def test_a_folder_is_searched_to_the_bottom(logs: Path, tmp_path: Path) -> None:
    jobs = find_jobs([str(logs)], tmp_path / "out")
    assert [job.name for job in jobs] == ["day1/a", "day2/bag", "day10/c", "day10/c_3"]
    assert [len(job.inputs) for job in jobs] == [1, 1, 3, 1]
    assert [job.bytes for job in jobs[:2]] == [1, 2]


def test_copies_of_one_recording_are_not_its_parts(tmp_path: Path) -> None:
    """The same times, and a part of them."""
    messages = small_drive("cdr", frames=9)
    for number, part in enumerate((messages, messages, messages, messages[len(messages) // 2 :])):
        write_mcap(tmp_path / f"d_{number}.mcap", part)
    assert names([tmp_path], tmp_path / "out") == ["d_0", "d_1", "d_2", "d_3"]


def test_results_below_the_folder_are_no_recordings(logs: Path) -> None:
    found = names([logs], logs / "out")
    for folder in ("out", "earlier", "day1/a.lidcam"):  # of this batch, of an earlier one, of `lidcam a.bag`
        (logs / folder).mkdir()
        (logs / folder / "r.mcap").write_bytes(b"1")
    (logs / "earlier" / ".lidcam-batch").mkdir()
    assert names([logs], logs / "out") == found
    assert names([logs / "earlier"], logs / "out") == ["r"]  # who names it means it
    with pytest.raises(RecordingError, match="another folder for the results"):
        find_jobs([str(logs)], logs)


def test_files_patterns_lists_and_urls(logs: Path, tmp_path: Path) -> None:
    out, a = tmp_path / "out", logs / "day1" / "a.bag"
    assert names([a], out) == names([a, a], out) == names([logs / "day1" / "*.bag"], out) == ["a"]
    listed = tmp_path / "list.txt"
    # With the mark and the ends of lines of an editor of Windows.
    listed.write_text(f"# a comment\r\n{a}\r\n  # another\r\n\r\n{logs / 'day2' / 'bag'}\r\n", encoding="utf-8-sig")
    assert names([f"@{listed}"], out) == ["a", "bag"]
    listed.write_text(f"{logs / 'day1' / '*.bag'}\n")
    assert names([f"@{listed}"], out) == ["a"]
    (job,) = find_jobs(["https://host/b.mcap?signature=secret"], out)
    assert job.name == "b"
    assert isinstance(job.inputs[0], RemotePath)


def test_a_bag_folder_that_one_is_in(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "bag" / "sub").mkdir(parents=True)
    (tmp_path / "bag" / "metadata.yaml").touch()
    for here, given in (("bag", "."), ("bag/sub", "..")):
        monkeypatch.chdir(tmp_path / here)
        assert [job.name for job in find_jobs([given], tmp_path / "out")] == ["bag"]


def test_a_recording_and_its_conversion_beside_it(tmp_path: Path) -> None:
    logs = tmp_path / "logs"
    (logs / "sub").mkdir(parents=True)
    for name in ("drive.bag", "drive.mcap", "other.bag", "sub/drive.bag", "._other.bag"):
        (logs / name).write_bytes(b"1")
    assert names([logs], tmp_path / "out") == ["drive.bag", "drive.mcap", "other", "sub/drive"]


def test_a_pattern_that_the_results_fit_does_not_take_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "a.bag").write_bytes(b"1")
    (tmp_path / "results").mkdir()
    (tmp_path / "results" / "a.mcap").write_bytes(b"1")
    monkeypatch.chdir(tmp_path)
    assert names(["*"], Path("results")) == ["a"]


@pytest.mark.parametrize(
    ("given", "fault"),
    [
        (["nothing.bag"], "found nothing of this name"),
        (["*.none"], "found nothing of this pattern"),
        (["@nothing.txt"], "expected a list of recordings"),
        (["empty"], "expected recordings"),
        (["@nobody"], "expected recordings, found none"),
        ([], "expected recordings, found none"),
        (["a" * 300], "cannot be searched for recordings: File name too long"),
        (["fifo"], "found a device or a pipe"),
        (["@fifo"], "expected a regular file, found a FIFO or a device"),
        (["one/a.bag", "two/a.bag"], "would both become a.mcap"),
    ],
)
def test_what_is_no_recording_is_told(
    given: list[str], fault: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for folder in ("empty", "one", "two"):
        (tmp_path / folder).mkdir()
    for folder in ("one", "two"):
        (tmp_path / folder / "a.bag").write_bytes(b"1")
    monkeypatch.chdir(tmp_path)
    Path("nobody").write_text("# none yet\n", encoding="utf-8")
    os.mkfifo("fifo")
    with pytest.raises(RecordingError, match=fault):
        find_jobs(given, tmp_path / "out")
