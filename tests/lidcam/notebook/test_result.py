"""Runs in notebooks: read back from their results, shown as tables, drawn, opened in a viewer."""

import re
import sys
from dataclasses import astuple, fields, replace
from typing import Any

import matplotlib as mpl
import numpy as np
import pytest
from helpers import CLUSTERS, CROSSING

import lidcam
from lidcam.notebook import loaded
from lidcam.pipeline.core.arrays import columns, join_rows

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
    own["road_users"] = repr(astuple(own["road_users"]))  # NaN is not equal to itself
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
    words = f"expected a result of lidcam, found a recording; run `lidcam process {CROSSING} OUT.mcap` first"
    with pytest.raises(lidcam.RecordingError, match=re.escape(words)):
        lidcam.load(CROSSING)
    monkeypatch.setattr(loaded, "SCENE", "/nothing")
    with pytest.raises(lidcam.RecordingError, match=r"out\.mcap: is damaged, or of another version of lidcam: '/noth"):
        lidcam.load(run.summary.outputs[0])


def test_the_tables_of_the_console_in_a_notebook(run: lidcam.RunResult) -> None:
    page = run._repr_html_()
    assert page.startswith("<pre style=")
    for words in ("road users", "pedestrian", f"of {run.frames} frames; -v", f"{run.frames} frames in"):
        assert words in page
    assert "verdict" not in page
    found = lidcam.inspect(CROSSING)
    assert isinstance(found, lidcam.Inspection)
    assert str(found).splitlines()[1] == "verdict: sound, and all of its sensors can be used"
    assert "/lidar_north_east/velodyne_packets" in found._repr_html_()  # type: ignore[attr-defined]  # of what notebooks show, a subclass
    path = run.summary.outputs[0]
    assert str(lidcam.evaluate(path)).startswith("out.mcap: ")
    assert str(lidcam.compare(path, path)).splitlines()[2].startswith("frames: ")
    hostile = replace(run.objects, class_names=("<script>",) * 9)
    assert "<script>" not in hostile._repr_html_()


def test_objects_scroll_in_a_notebook(run: lidcam.RunResult) -> None:
    page = run.objects._repr_html_()
    assert page.count("<tr>") == 1 + len(run.objects)
    assert "overflow: auto" in page
    assert all(f">{name}</th>" in page for name in run.objects.columns)
    many = join_rows(*[run.objects] * (1 + 1000 // len(run.objects)))
    assert many._repr_html_().count("<tr>") == 1001
    assert f"... {len(many) - 1000} more" in many._repr_html_()


def test_a_frame_has_its_objects(run: lidcam.RunResult) -> None:
    frames = [*lidcam.iter_frames(CROSSING, settings=[CLUSTERS], duration_s=0.7, workers=1)]
    assert [len(frame.objects) for frame in frames] == np.bincount(run.objects.frames).tolist()
    for name, *_ in columns(lidcam.Objects):
        together = np.concatenate([getattr(frame.objects, name) for frame in frames])
        np.testing.assert_array_equal(together, getattr(run.objects, name), err_msg=name)
    np.testing.assert_allclose(run.objects.speeds_km_h, run.objects.speeds * 3.6)


def line_of(axes: Any, label: str) -> Any:
    """The x and y of what is drawn as this, with gaps of NaN."""
    (line,) = [one for one in axes.get_lines() if one.get_label() == label]
    return np.column_stack(line.get_data())


def test_the_plot_has_each_track_in_the_colour_of_its_class(
    run: lidcam.RunResult, monkeypatch: pytest.MonkeyPatch
) -> None:
    axes, objects = run.plot(), run.objects
    for class_id in np.unique(objects.class_ids).tolist():
        own = objects[objects.class_ids == class_id]
        tracks = np.unique(own.tracks)
        drawn = line_of(axes, f"{objects.class_names[class_id]} ({len(tracks)})")
        parts = np.split(drawn, np.flatnonzero(np.isnan(drawn[:, 0])))
        expected = [own.centers[own.tracks == track, :2] for track in tracks.tolist()]
        for part, way in zip(parts, expected, strict=True):
            np.testing.assert_allclose(part[np.isfinite(part[:, 0])], way)
    (image,) = axes.get_images()  # what stands still
    assert (image.get_array()[..., 3] > 0).any()
    nothing = lidcam.RunResult(run.summary, objects[:0]).plot()
    assert nothing.get_legend() is None
    assert axes is lidcam.RunResult(run.summary, objects[:0]).plot(axes)
    monkeypatch.chdir(run.summary.outputs[0].parent)
    loaded = lidcam.load(run.summary.outputs[0].name)
    monkeypatch.chdir("/")
    back = loaded.plot()
    for one, other in zip(axes.get_lines(), back.get_lines(), strict=True):
        np.testing.assert_allclose(one.get_data(), other.get_data())


def test_tracks_of_a_rig_that_moves_are_drawn_in_a_fixed_frame(run: lidcam.RunResult) -> None:
    """The rig drives 1 m a frame along y, having turned left: what it sees 10 m ahead stands further along y."""
    count = run.frames
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, :2, :2] = [[0, -1], [1, 0]]
    poses[:, 1, 3] = np.arange(count)
    site = replace(run.make_map(), poses=poses, moves=True)
    ahead = run.objects.select(np.unique(run.objects.frames, return_index=True)[1])
    ahead = replace(ahead, centers=np.tile([10.0, 0, 0], (count, 1)), tracks=np.ones(count, np.int64))
    axes = lidcam.RunResult(run.summary, ahead, lambda: site).plot()
    np.testing.assert_allclose(line_of(axes, "path of the sensors"), np.column_stack([np.zeros(count), range(count)]))
    drawn = np.concatenate([line.get_xydata() for line in axes.get_lines()[1:]])
    np.testing.assert_allclose(drawn[np.isfinite(drawn[:, 0])][:, 0], 0, atol=1e-9)
    assert set(drawn[np.isfinite(drawn[:, 0])][:, 1].round(6)) == {10.0 + number for number in range(count)}
    assert "in a fixed frame" in axes.get_title(loc="left")


def test_speeds_and_counts_are_plotted(run: lidcam.RunResult) -> None:
    axes = run.plot_speeds()
    moved, count = map(int, re.findall(r"\d+", axes.get_title(loc="left")))
    has_speed = np.isfinite(run.objects.speeds)  # a track of a few frames has none
    assert count == len(np.unique(run.objects.tracks[has_speed]))
    assert sum(bar.get_height() for bar in axes.patches) == moved
    nobody = replace(run, objects=run.objects[:0]).plot_speeds()
    assert [text.get_text() for text in nobody.texts] == ["no road user moved"]
    in_m_s = run.plot_speeds(units="m/s")
    assert in_m_s.get_xlim()[1] < axes.get_xlim()[1]
    with pytest.raises(lidcam.ConfigError, match="units: expected km/h or m/s, found 'mph'"):
        run.plot_speeds(units="mph")  # type: ignore[arg-type]
    lines = {"far away": ((500, 0), (500, 1)), "all": ((-100, -6), (100, 6))}
    counted = run.plot_counts(lines=lines)
    users = run.summary.road_users
    assert users is not None
    names = [text.get_text() for text in counted.get_yticklabels()]
    ways = [f"{line}, to the {way}" for line in lines for way in ("left", "right")]
    assert names == ["everywhere", *ways]
    widths = dict.fromkeys(names, 0.0)
    for bars in counted.containers:
        for name, bar in zip(names, bars, strict=True):
            widths[name] += bar.get_width()
    crossed = run.count_lines(lines)
    assert widths["everywhere"] == sum(one.count for one in users.counts if not one.zone)
    assert widths["all, to the left"] == sum(one.to_left for one in crossed)
    assert widths["all, to the right"] == sum(one.to_right for one in crossed)
    untracked = replace(run.summary, road_users=None)
    with pytest.raises(lidcam.LidcamError, match="expected tracks, found a run without them"):
        lidcam.RunResult(untracked, run.objects).plot_counts()


def test_what_is_missing_for_a_plot_is_one_line(run: lidcam.RunResult, monkeypatch: pytest.MonkeyPatch) -> None:
    draws = ("matplotlib.pyplot", run.plot), ("matplotlib.pyplot", run.plot_counts), ("rerun_notebook", run.show)
    for package, draw in draws:
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
