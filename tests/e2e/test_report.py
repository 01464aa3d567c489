"""The page about a result: from a run, from the command, and what it says of results that lack something."""

import json
import re
from pathlib import Path
from typing import Any

import plotly.graph_objects as go
import pytest
from builders import write_mcap
from command import called
from frames import frame, written_result
from helpers import CLUSTERS, SANDBOX
from small_drive import small_drive

import lidcam
from lidcam.outputs.report.make import make_page

EMBEDDED = re.compile(r'<script type="application/json" id="figures">(.*?)</script>', re.DOTALL)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("report")
    outputs = [made / "out.mcap", made / "out.html", made / "out.mp4"]
    lidcam.process(SANDBOX, outputs, config="sandbox", settings=[CLUSTERS], duration_s=0.6, workers=1)
    return made


def figures_of(page: str) -> dict[str, Any]:
    (text,) = EMBEDDED.findall(page)
    tree: dict[str, Any] = json.loads(text)
    return tree


def test_a_run_and_the_command_write_the_same(folder: Path) -> None:
    done = called(folder, "report", "out.mcap", "--out", "again.html")
    assert (done.code, done.err.splitlines()[-1]) == (0, "wrote again.html")
    assert (folder / "again.html").read_bytes() == (folder / "out.html").read_bytes()
    (folder / "again.html").write_text("mine", encoding="utf-8")
    refused = called(folder, "report", "out.mcap", "--out", "again.html")
    assert "exists and is no page about a result" in refused.error_line


def test_a_page_about_a_damaged_result_says_so(folder: Path) -> None:
    content = (folder / "out.mcap").read_bytes()
    (folder / "cut.mcap").write_bytes(content[: 2 * len(content) // 3])
    done = called(folder, "report", "cut.mcap")
    assert done.code == 3
    assert "incomplete: cut.mcap: damaged" in done.err
    assert (folder / "cut.html").exists()


def test_a_page_says_what_was_seen_and_stands_alone(folder: Path) -> None:
    page = (folder / "out.html").read_text(encoding="utf-8")
    content = re.sub(r"<script.*?</script>", "", page, flags=re.DOTALL)
    assert "2 road users in 0.4 s: 2 \u00d7 car. 2 moved." in content
    assert "sandbox.bag" in content
    assert str(folder) not in page
    assert str(SANDBOX.parent) not in page
    assert re.findall(r'(?:src|href)="(?!#|data:)([^"]*)', content) == ["out.mp4#t=0.1"]  # the film beside it
    assert content.count('<img src="data:image/jpeg') > 2  # of the busiest moment, and of errors
    assert "url(" not in content
    assert {"map", "objects", "sensors", "skew", "speeds", "dwell", "curves", "errors"} == figures_of(page).keys()
    assert len(page) < 2_000_000


def test_plotly_knows_every_property_of_the_figures(folder: Path) -> None:
    themed = {"@class": "#123456", "@speed": "#123456", "@source": "#123456"}
    text = (folder / "out.html").read_text(encoding="utf-8")
    for name, figure in figures_of(text).items():
        colored = re.sub(
            r'"(@[a-z]+)[^"]*"', lambda found: json.dumps(themed.get(found[1], "#654321")), json.dumps(figure)
        )
        tree = json.loads(colored)
        go.Figure(data=tree["data"], layout=tree["layout"])  # raises at one that it does not know
        assert tree["data"], name


def test_a_page_is_made_of_a_result(tmp_path: Path) -> None:
    with pytest.raises(lidcam.OutputError, match=r"out\.html: needs an \.mcap output as well"):
        lidcam.process(SANDBOX, tmp_path / "out.html")
    write_mcap(tmp_path / "drive.mcap", small_drive("cdr"))
    assert "expected a result of lidcam, found a recording" in called(tmp_path, "report", "drive.mcap").error_line


@pytest.mark.parametrize(
    ("objects", "said"),
    [(0, ["Nothing was found in 0.1 s."]), (3, ["They were not tracked", ">no truth: out.mcap: expected truth"])],
)
def test_what_is_lacking_is_said(tmp_path: Path, objects: int, said: list[str]) -> None:
    mcap = written_result(tmp_path / "out.mcap", [frame(index, objects=objects) for index in range(2)])
    made, incomplete = make_page(mcap)
    assert incomplete == ()
    assert all(words in made for words in said)
    (tmp_path / "other").mkdir()
    assert make_page(mcap.rename(tmp_path / "other" / "out.mcap"))[0] == made
