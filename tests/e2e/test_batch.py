"""`lidcam batch`: results beside those of `lidcam process`, a table of all, and a second run that does nothing."""

import json
import re
from pathlib import Path

import pyarrow.parquet as pq
import pytest
from builders import write_mcap
from command import Lidcam
from small_drive import small_drive

SHORT = ("--duration", "0.4", "--set", "fuse.min_score=0.2")
"""The points are drawn at random: a car of .29 is what there is to see."""


@pytest.fixture
def logs(tmp_path: Path) -> Path:
    (tmp_path / "logs" / "day").mkdir(parents=True)
    write_mcap(tmp_path / "logs" / "day" / "a & b.mcap", small_drive("cdr"))
    (tmp_path / "logs" / "text.bag").write_bytes(b"no recording")
    return tmp_path / "logs"


def test_a_batch_makes_what_single_runs_make_and_a_page(lidcam: Lidcam, logs: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    given = ("batch", logs, "--out", out, *SHORT, "--objects", "--report", "--every", 2)
    run = lidcam(*given, "--json")
    assert run.code == 1
    assert "1 of 2 recordings failed: text: " in run.error_line
    done, failed = json.loads(run.out)["jobs"]
    assert (done["name"], done["state"], done["frames"], done["exit_code"]) == ("day/a & b", "done", 2, 0)
    assert (failed["state"], failed["exit_code"]) == ("failed", 1)
    assert "expected a ROS 1 .bag" in failed["message"]
    assert done["processor_s"] > 0
    assert lidcam("process", logs / "day" / "a & b.mcap", tmp_path / "one.mcap", *SHORT, "--every", 2).code == 0
    assert (out / "day" / "a & b.mcap").read_bytes() == (tmp_path / "one.mcap").read_bytes()
    assert pq.read_table(out / "_jobs.parquet").column("state").to_pylist() == ["done", "failed"]
    assert pq.read_table(out / "day" / "a & b.parquet").num_columns > 10
    page = (out / "index.html").read_text(encoding="utf-8")
    assert "<td>day/a &amp; b</td>" in page
    assert 'href="day/a%20%26%20b.html"' in page
    assert 'href="day/a%20%26%20b.mcap"' in page
    assert page.count("data:image/jpeg;base64,") == 1
    assert '<td colspan="5">failed<br>' in page
    (out / "index.html").write_text("somebody else's", encoding="utf-8")
    before = (out / "day" / "a & b.mcap").stat().st_mtime_ns
    again = lidcam(*given)
    assert again.code == 1
    assert "index.html was not written by lidcam: it stays as it is" in again.err
    assert (out / "index.html").read_text(encoding="utf-8") == "somebody else's"
    assert re.search(r"^day/a & b +up to date +2 ", again.out, re.MULTILINE)
    assert again.out.splitlines()[-1] == "1 failed, 1 up to date; 2 frames; road users: 1 car"
    assert (out / "day" / "a & b.mcap").stat().st_mtime_ns == before
