"""What a run may replace: outputs of earlier runs of its kind, never a recording, an edited file or an input."""

import os
import shutil
from pathlib import Path

import pytest
from builders import raw, write_mcap, write_rosbag1, write_rosbag2
from helpers import CLUSTERS
from logging_state import kept_logging
from mcap.writer import Writer
from small_drive import small_drive

import lidcam
from lidcam.bags.simulator.recorder.files import recording_file, recording_names, ros_version_of
from lidcam.bags.simulator.recorder.messages import MessageFactory
from lidcam.cli.inspect import inspect as run_inspect
from lidcam.outputs.allowed import REPAIRED, SIMULATED, TEXT, check_no_input, check_replaced
from lidcam.outputs.registry import OUTPUTS, loaded
from lidcam.pipeline.core.errors import OutputError
from lidcam.pipeline.core.messages import RawMessage
from lidcam.writers.outputs.marks import is_unchanged_text, marked_yaml
from lidcam.writers.outputs.transaction import OutputTransaction

OWN = {output.name: loaded(output.is_own) for output in OUTPUTS if output.is_own} | {
    "repaired": REPAIRED.is_own,
    "simulated": SIMULATED.is_own,
    "text": TEXT.is_own,
}
JPEG = b"\xff\xd8\xff\xe0" + bytes(16) + b"\xff\xfe\x00\x14lidcam.matches {}"
REFUSED = "choose another name, or replace it with --overwrite, in Python overwrite=True"


def recognised(path: Path) -> list[str]:
    """What a file or folder is taken for."""
    return [name for name, is_own in OWN.items() if is_own(path)]


def clouds() -> list[RawMessage]:
    return small_drive("cdr", frames=3, motion="none", kinds=())


def recorded(path: Path) -> Path:
    write_mcap(path, clouds())
    return path


def simulate(path: Path, *, overwrite: bool = False) -> Path:
    make = MessageFactory(ros_version_of(path), 0)
    check_old = check_replaced(lambda path: TEXT if path.suffix == ".yaml" else SIMULATED, overwrite=overwrite)
    with (
        OutputTransaction(recording_names(path), check_old=check_old) as outputs,
        recording_file(outputs, path, rig_yaml="site_frame: s\n", scenario_yaml="world: sandbox\n") as write,
    ):
        write(make.recorded(0, "/wheel", 0, make.number(1.0)), 0)
    return path


def inspect(recording: Path, **options: object) -> None:
    with kept_logging():
        run_inspect([str(recording)], **options)


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with one of each."""
    folder = tmp_path_factory.mktemp("results")
    recorded(folder / "rec.mcap")
    write_rosbag1(folder / "rec.bag", [raw("/a", "std_msgs/msg/String", {"data": "x"}, 1, encoding="ros1")])
    write_rosbag2(folder / "rec", clouds())
    outputs = [folder / f"out.{kind}" for kind in ("mcap", "rrd", "csv", "parquet", "mp4", "html")]
    lidcam.process(folder / "rec.mcap", outputs, settings=[CLUSTERS])
    (folder / "images").mkdir()
    (folder / "images" / "frame_000000_cam.jpg").write_bytes(JPEG)
    inspect(folder / "rec.mcap", repair=folder / "repaired.mcap", write_rig=folder / "rig.yaml")
    for name in ("sim.bag", "sim.mcap"):
        simulate(folder / name)
    return folder


@pytest.mark.parametrize(
    ("name", "made"),
    [
        ("out.mcap", "Foxglove"),
        ("out.rrd", "Rerun"),
        ("out.csv", "CSV"),
        ("out.parquet", "Parquet"),
        ("out.mp4", "Film"),
        ("out.html", "Report"),
        ("images", "Images"),
        ("out.foxglove.json", "text"),
        ("repaired.mcap", "repaired"),
        ("rig.yaml", "text"),
        ("sim.bag", "simulated"),
        ("rec.mcap", None),
        ("rec", None),
    ],
)
def test_the_content_says_what_lidcam_made(results: Path, name: str, made: str | None) -> None:
    assert recognised(results / name) == ([] if made is None else [made])


@pytest.mark.parametrize(
    "name", ["out.mcap", "out.parquet", "repaired.mcap", "sim.bag", "sim.mcap", "rig.yaml", "out.foxglove.json"]
)
def test_what_is_cut_or_changed_is_not_lidcam_s(results: Path, tmp_path: Path, name: str) -> None:
    content = (results / name).read_bytes()
    path = tmp_path / name
    for size in {0, 20, len(content) // 2, len(content) - 8, len(content) - 1}:
        path.write_bytes(content[:size])
        assert recognised(path) == [], size
    path.write_bytes(content + b"\n")
    assert recognised(path) == [] or name == "sim.bag"


def test_what_only_looks_like_it_is_not_lidcam_s(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    assert recognised(tmp_path / "pipe") == []
    (tmp_path / "empty").mkdir()
    assert recognised(tmp_path / "empty") == ["Images"]  # nothing is lost with it
    for library in ("lidcam", "another"):
        with (tmp_path / library).open("wb") as file:
            writer = Writer(file)
            writer.start("ros2", library)
            writer.add_metadata("lidcam" if library == "another" else "notes", {})
            writer.finish()  # type: ignore[no-untyped-call]  # mcap annotates in part
        assert recognised(tmp_path / library) == []


@pytest.mark.parametrize("text", ["", "a: 1\n", "a: ü\n\n", "# x\n"])
def test_marked_text_is_unchanged_until_it_is_changed(text: str) -> None:
    marked = marked_yaml(text)
    assert [is_unchanged_text(one) for one in (marked, f"{marked} ", text)] == [True, False, False]


@pytest.fixture
def files(results: Path, tmp_path: Path) -> Path:
    return shutil.copytree(results, tmp_path / "files")


def test_results_are_replaced_and_an_edited_layout_is_not(files: Path) -> None:
    outputs = [files / f"out.{kind}" for kind in ("mcap", "rrd", "csv", "parquet")]
    lidcam.process(files / "rec.mcap", outputs, settings=[CLUSTERS], start_s=0.1)
    with (files / "out.foxglove.json").open("a") as file:
        file.write("\n")
    before = {path: path.read_bytes() for path in files.glob("out.*")}
    with pytest.raises(OutputError, match=rf"out\.foxglove\.json: .*{REFUSED}"):
        lidcam.process(files / "rec.mcap", outputs)
    assert {path: path.read_bytes() for path in files.glob("out.*")} == before
    assert not list(files.glob(".*"))
    lidcam.process(files / "rec.mcap", outputs, settings=["output.layout=false", CLUSTERS])


def test_each_command_replaces_only_its_own(files: Path) -> None:
    inspect(files / "rec.mcap", write_rig=files / "rig.yaml", repair=files / "repaired.mcap")
    simulate(files / "sim.bag")
    with (files / "rig.yaml").open("a") as file:
        file.write("# measured by hand\n")
    with pytest.raises(OutputError, match=REFUSED):
        inspect(files / "rec.mcap", write_rig=files / "rig.yaml")
    with pytest.raises(OutputError, match=REFUSED):
        inspect(files / "rec.mcap", repair=files / "out.mcap")
    with pytest.raises(OutputError, match=REFUSED):
        simulate(files / "rec.bag")
    assert (files / "rig.yaml").read_text().endswith("# measured by hand\n")
    simulate(files / "rec.bag", overwrite=True)
    assert recognised(files / "rec.bag") == ["simulated"]


def test_no_output_is_an_input(files: Path) -> None:
    (files / "hard.mcap").hardlink_to(files / "rec.mcap")
    (files / "link.mcap").symlink_to("rec.mcap")
    inputs = ["rec.mcap", "rec/../rec.mcap", "hard.mcap", "link.mcap", "rec.mcap-wal", "rec/metadata.yaml", "rec"]
    for name in inputs:
        with pytest.raises(OutputError, match="is an input of this run"):
            check_no_input([files / "new.mcap", files / name], [files / "rec.mcap", files / "rec"])
    check_no_input([files / "new.mcap", files / "out.mcap", files / "a\0b"], [files / "rec.mcap", files / "rec"])


@pytest.mark.parametrize("kind", ["rig", "config", "model_2d", "model_3d"])
def test_a_file_that_the_run_reads_is_not_replaced(files: Path, kind: str) -> None:
    read = (files / "rig.yaml").rename(files / "read.foxglove.json")
    if kind == "config":
        read.write_text(marked_yaml("output: {images: false}\n"))
    before = read.read_bytes()
    with pytest.raises(OutputError, match=r"read\.foxglove\.json: is an input of this run"):
        lidcam.process(files / "rec.mcap", files / "read.mcap", overwrite=True, **{kind: read})  # type: ignore[arg-type]
    assert read.read_bytes() == before


def test_what_a_killed_run_left_can_be_repaired_and_is_not_removed(tmp_path: Path) -> None:
    """`inspect drive.mcap.part --repair drive.mcap` truncated and removed its input."""
    part = tmp_path / "drive.mcap.part"
    recorded(part)
    before = part.read_bytes()
    inspect(part, repair=tmp_path / "drive.mcap")
    assert part.read_bytes() == before
    left = tmp_path / ".other.mcap.lidcam-x" / "other.mcap"
    left.parent.mkdir(parents=True)
    part.rename(left)
    with pytest.raises(OutputError, match="what a killed run has left of this output; move it elsewhere"):
        inspect(left, repair=tmp_path / "other.mcap")
    assert left.read_bytes() == before


@pytest.mark.parametrize("foreign", ["notes.txt", "folder", "link.jpg", "other.jpg"])
def test_a_folder_with_anything_else_is_never_replaced(results: Path, tmp_path: Path, foreign: str) -> None:
    out = shutil.copytree(results / "images", tmp_path / "images")
    if foreign == "folder":
        (out / foreign).mkdir()
    elif foreign == "link.jpg":
        (out / foreign).symlink_to("frame_000000_cam.jpg")
    else:
        (out / foreign).write_bytes(JPEG[:20])
    before = sorted(out.iterdir())
    for overwrite in (False, True):
        with pytest.raises(OutputError, match=r"holds more than the images of an earlier run; choose another name$"):
            lidcam.process(results / "rec.mcap", save_matches=out, overwrite=overwrite)
    assert sorted(out.iterdir()) == before
