"""`import lidcam`: the names it offers, and runs whose results are at hand."""

import inspect
import re
import subprocess
import sys
from importlib import import_module
from importlib.util import find_spec
from itertools import takewhile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from builders import write_rosbag1
from document_commands import pages
from helpers import CLUSTERS, ROOT, SANDBOX

import lidcam
from lidcam import api
from lidcam.pipeline.core.detections import source_names

CONFIG = ROOT / "config" / "sandbox.yaml"


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> lidcam.RunResult:
    return lidcam.process(
        SANDBOX, tmp_path_factory.mktemp("run") / "out.mcap", config=CONFIG, settings=[CLUSTERS], duration_s=0.5
    )


def test_every_name_is_there_and_no_other() -> None:
    for name in api.__all__:
        assert getattr(lidcam, name) is not None
        assert find_spec(f"lidcam.{name}") is None, "a module that is imported hides the name"
    assert set(api.__all__) <= set(dir(lidcam))
    assert lidcam.api is api
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        lidcam.nothing  # type: ignore[attr-defined]  # noqa: B018


def test_nothing_is_written_without_an_output(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    seen: list[int] = []
    options: dict[str, Any] = {"config": str(CONFIG), "settings": [CLUSTERS], "duration_s": 0.3}
    run = lidcam.process(str(SANDBOX), **options, on_frame=lambda frame: seen.append(frame.bundle.index))
    assert run.summary.outputs == ()
    assert seen == list(range(run.frames))
    assert list(tmp_path.iterdir()) == []


def test_settings_on_top_of_a_config() -> None:
    config = lidcam.load_config(CONFIG, {"sync.slop_s": 0.05, "topics.exclude": ["/a"]})
    assert (config.sync.slop_s, config.topics.exclude) == (0.05, ("/a",))
    job = lidcam.make_job(SANDBOX, config=config, settings=["sync.queue_size=3"], workers=1, model_2d="x.onnx")
    assert (job.config.sync.slop_s, job.config.sync.queue_size, job.config.run.workers) == (0.05, 3, 1)
    assert job.config.detect2d.model == Path("x.onnx")
    assert job.config.combine == config.combine


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"worker": 1}, TypeError, "got worker: did you mean 'workers'"),
        ({"start_s": -1.0}, lidcam.ConfigError, "start_s: expected 0 s or more"),
        ({"duration_s": 0.0}, lidcam.ConfigError, "duration_s: expected more than 0 s"),
        ({"on_bad_message": "foo"}, lidcam.ConfigError, "expected skip or fail, found 'foo'"),
    ],
)
def test_options_that_cannot_be(options: dict[str, Any], error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        lidcam.process(SANDBOX, **options)


@pytest.mark.parametrize("name", ["process", "iter_frames", "make_job", "batch"])
def test_help_shows_every_option(name: str) -> None:
    """As completion in a notebook does, which looks at the signature."""
    function = getattr(lidcam, name)
    parameters = inspect.signature(function).parameters
    options = lidcam.SharedOptions if name == "batch" else lidcam.JobOptions
    assert set(options.__annotations__) <= set(parameters)
    assert not [one for one in parameters.values() if one.kind == one.VAR_KEYWORD]
    assert parameters["start_s"].default == 0.0
    arguments = function.__doc__.partition("Args:")[2].partition("\n\n")[0]
    documented = re.findall(r"^ {8}(\w+): ", arguments, re.MULTILINE)
    assert documented == [*parameters]


def test_results_are_compared_exported_and_reported(run: lidcam.RunResult, tmp_path: Path) -> None:
    result = run.summary.outputs[0]
    assert lidcam.compare(result, result).is_equal
    moved = tmp_path / "moved.mcap"
    lidcam.process(SANDBOX, moved, config=CONFIG, settings=[CLUSTERS, "track.mode=none"], duration_s=0.5)
    found = lidcam.compare(result, moved, only=["fused"])
    assert not found.is_equal
    assert "fused: expected at most 0 % of the objects to differ" in found.failures[0]
    assert lidcam.compare(result, moved, only="fused", allow="frames", max_different_percent=100).failures == ()
    with pytest.raises(lidcam.ConfigError, match=r"max_different_percent: expected 0 to 100, found -1"):
        lidcam.compare(result, result, max_different_percent=-1)
    with pytest.raises(lidcam.ConfigError, match=r"allow: expected lost, new, .*, frames, found 'swapped'"):
        lidcam.compare(result, result, allow=["swapped"])
    done = lidcam.export(result, tmp_path / "set", format="nuscenes")
    assert (done.frames, done.boxes > 0) == (run.frames, True)
    assert (tmp_path / "set").is_dir()
    page = lidcam.report(result, tmp_path / "page.html")
    assert "<html" in page.read_text(encoding="utf-8")
    with pytest.raises(lidcam.OutputError, match="is an input of this run"):
        lidcam.report(result, result)


def test_a_batch(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "bad.bag").write_bytes(b"no bag")
    (tmp_path / "in" / "good.bag").symlink_to(SANDBOX)
    options: dict[str, Any] = {"config": CONFIG, "settings": [CLUSTERS], "duration_s": 0.3}
    done = lidcam.batch(str(tmp_path / "in"), tmp_path / "out", **options, objects=True)
    assert [(one.name, one.state) for one in done.records] == [("bad", "failed"), ("good", "done")]
    assert [one.name for one in done.failed] == ["bad"]
    assert (tmp_path / "out" / "good.parquet").is_file()
    assert Path(done.table).is_file()
    assert "bad" in str(done)
    assert "<pre" in done._repr_html_()  # type: ignore[attr-defined]  # of what notebooks show, a subclass
    with pytest.raises(TypeError, match="view"):
        lidcam.batch("in", "out", view=True)  # type: ignore[call-arg]  # wrong on purpose


def test_what_is_not_known_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(lidcam.ModelError, match="fetch: expected yolox-nano, yolox-tiny, yolox-s, found 'yolo'"):
        lidcam.fetch("yolo")  # type: ignore[arg-type]  # wrong on purpose
    with pytest.raises(lidcam.ConfigError, match="sandbx"):
        lidcam.simulate("sandbx", tmp_path / "out.bag")
    with pytest.raises(lidcam.ConfigError, match=r"^duration_s: expected more than 0 s, found -1"):
        lidcam.simulate("sandbox", tmp_path / "out.bag", duration_s=-1)
    with pytest.raises(lidcam.ConfigError, match=r"^settings: sync\.every: expected key\.key=value"):
        lidcam.process(SANDBOX, tmp_path / "out.mcap", settings=["sync.every"])
    with pytest.raises(lidcam.CalibrationError, match=r"expected a preset \(original\) or a rig file"):
        lidcam.load_rig("orginal")


@pytest.mark.parametrize("library", ["pandas", "polars", "pyarrow"])
def test_tables(run: lidcam.RunResult, library: str, monkeypatch: pytest.MonkeyPatch) -> None:
    objects = run.objects
    convert = {"pandas": objects.to_pandas, "polars": objects.to_polars, "pyarrow": objects.to_arrow}[library]
    import_module(library)
    table = convert()
    assert list(table.columns if library != "pyarrow" else table.column_names) == list(objects.columns)
    assert np.array_equal(np.asarray(table["x_m"]), objects.centers[:, 0])
    assert [str(name) for name in table["class"]] == ["car"] * len(objects)
    assert [str(name) for name in table["source"]] == source_names(objects.sources)
    assert np.array_equal(np.asarray(table["measured_ns"]), objects.measured_ns)
    monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(ImportError, match=f"pip install {library}"):
        convert()


PAGES = [path for path in pages() if "```python" in path.read_text(encoding="utf-8")]


@pytest.fixture(scope="module")
def short_drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of the sample, as much as the examples look at."""
    path = tmp_path_factory.mktemp("short") / "drive.bag"
    with lidcam.open_recording([SANDBOX]) as recording:
        until_ns = recording.start_ns + 1_300_000_000
        write_rosbag1(path, takewhile(lambda message: message.log_time_ns < until_ns, recording.messages()))
    return path


@pytest.mark.slow
@pytest.mark.parametrize("page", [pytest.param(path, id=path.name) for path in PAGES])
def test_examples_of_the_documents_run(page: Path, tmp_path: Path, short_drive: Path) -> None:
    """All blocks of a page as one script, beside a recording of the name that they use."""
    blocks = re.findall(r"```python\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)
    assert blocks
    (tmp_path / "drive.bag").symlink_to(short_drive)
    if '"out.mcap"' in "".join(blocks):  # some read a result
        lidcam.process(short_drive, tmp_path / "out.mcap", config="sandbox", duration_s=0.5)
    body = "\n".join(blocks).replace("\n", "\n    ")
    script = tmp_path / "example.py"
    script.write_text(f"if __name__ == '__main__':\n    {body}\n", encoding="utf-8")
    done = subprocess.run([sys.executable, script], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout
