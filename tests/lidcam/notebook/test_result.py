"""Runs in notebooks: read back from their results, shown as tables, drawn, opened in a viewer."""

import sys
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import pytest
from helpers import CLUSTERS

import lidcam
from lidcam.notebook import loaded
from lidcam.pipeline.core.arrays import columns
from lidcam.writers.palette import class_color

BAGS = Path(__file__).resolve().parents[3] / "bags"
CROSSING = BAGS / "crossing.mcap"

mpl.use("Agg")


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> lidcam.RunResult:
    outputs = [tmp_path_factory.mktemp("run") / name for name in ("out.mcap", "out.rrd")]
    return lidcam.process(CROSSING, outputs, settings=[CLUSTERS], duration_s=0.7, workers=1)


def of_result(summary: Any) -> dict[str, Any]:
    """What a result holds of a summary."""
    own = {field.name: getattr(summary, field.name) for field in fields(summary)}
    for name in ("timing", "settings", "outputs", "how_to_open"):
        own.pop(name)
    files = tuple(file._replace(path="") for file in own.pop("inputs").files)
    return own | {"files": files, "sensors": replace(own["sensors"], rig=None), "rig": repr(own["sensors"].rig)}


def test_a_run_is_read_back_from_its_result(run: lidcam.RunResult) -> None:
    back = lidcam.load(run.summary.outputs[0])
    assert len(back.objects) > 20
    for name, *_ in columns(lidcam.Objects):
        np.testing.assert_allclose(getattr(back.objects, name), getattr(run.objects, name), rtol=1e-12, err_msg=name)
    assert (back.objects.frame_id, back.objects.class_names) == (run.objects.frame_id, run.objects.class_names)
    assert of_result(back.summary) == of_result(run.summary)
    assert back.summary.settings.name == str(run.summary.settings)
    assert back.summary.incomplete == run.summary.incomplete
    assert np.isnan(back.summary.timing.wall_seconds)


def test_what_is_no_result_or_lacks_something(run: lidcam.RunResult, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(lidcam.RecordingError, match="expected a result of lidcam, found a recording"):
        lidcam.load(CROSSING)
    monkeypatch.setattr(loaded, "SCENE", "/nothing")
    with pytest.raises(lidcam.RecordingError, match=r"out\.mcap: is damaged, or of another version of lidcam: '/noth"):
        lidcam.load(run.summary.outputs[0])


def test_the_tables_of_the_console_in_a_notebook(run: lidcam.RunResult) -> None:
    page = run._repr_html_()
    assert page.startswith("<pre style=")
    for words in ("road users", "pedestrian", f"missing from {run.frames} frames", f"{run.frames} frames in"):
        assert words in page
    assert "verdict" not in page
    found = lidcam.inspect(CROSSING)
    assert isinstance(found, lidcam.Inspection)
    assert "/lidar_north_east/velodyne_packets" in found._repr_html_()  # type: ignore[attr-defined]  # of what notebooks show, a subclass
    hostile = replace(run.objects, class_names=("<script>",) * 9)
    assert "<script>" not in hostile._repr_html_()


def test_the_plot_has_each_track_in_the_colour_of_its_class(run: lidcam.RunResult) -> None:
    axes = run.plot()
    ways = {
        (line.get_color(), *np.column_stack(line.get_data()).ravel().round(6).tolist()) for line in axes.get_lines()
    }
    objects = run.objects
    assert len(ways) == len({*zip(objects.class_ids.tolist(), objects.tracks.tolist(), strict=True)})
    own = objects.select(objects.tracks == objects.tracks[0])
    assert (class_color(own.class_ids[0]), *own.centers[:, :2].ravel().round(6).tolist()) in ways
    names = {text.get_text() for text in axes.get_legend().get_texts()}
    assert names == {*objects.classes.tolist()}
    nothing = lidcam.RunResult(run.summary, objects[:0]).plot()
    assert nothing.get_legend() is None
    assert axes is lidcam.RunResult(run.summary, objects[:0]).plot(axes)


def test_what_is_missing_for_a_plot_is_one_line(run: lidcam.RunResult, monkeypatch: pytest.MonkeyPatch) -> None:
    for package, draw in (("matplotlib.pyplot", run.plot), ("rerun_notebook", run.show)):
        monkeypatch.setitem(sys.modules, package, None)
        name = package.partition(".")[0].replace("_", "-")
        line = rf"needs {name}, which is not installed: pip install 'lidcam\[notebook\]'$"
        with pytest.raises(lidcam.LidcamError, match=line):
            draw()
    with pytest.raises(lidcam.LidcamError, match=r"run\.show\(\): expected an \.rrd among the outputs of the run"):
        lidcam.load(run.summary.outputs[0]).show()


def test_the_viewer_gets_all_of_the_rerun_recording(run: lidcam.RunResult, monkeypatch: pytest.MonkeyPatch) -> None:
    streams = []

    class Viewer:
        def __init__(self, *, recording: Any, **_: Any) -> None:
            streams.append(recording.binary_stream())

        def display(self) -> None:
            assert streams[0].read() is not None

    monkeypatch.setattr("rerun.notebook.Viewer", Viewer)
    run.show()
    sent = streams[0].read(flush=True)
    assert len(sent) > 0.9 * run.summary.outputs[1].stat().st_size
