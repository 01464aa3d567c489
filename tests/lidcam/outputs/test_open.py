"""What an output says of how it was made."""

from collections.abc import Callable, Iterator
from hashlib import sha256
from pathlib import Path

import numpy as np
import pytest
from builders import pointcloud2, raw, tf_message, transform_stamped, write_mcap, write_rosbag2
from helpers import CLUSTERS, SANDBOX
from mcap.reader import make_reader
from onnx_files import write_yolox

import lidcam
from lidcam.outputs.allowed import RRD_STORE
from lidcam.pipeline.core.frame import FrameResult
from lidcam.pipeline.core.messages import RawMessage
from lidcam.processing import RunObserver, process_recording
from lidcam.readers.results.result import open_result
from lidcam.run.job import make_job

SMALL = {"output.images": False, "output.clouds": False, "detect3d.method": "cluster"}
START_NS = 1_700_000_000 * 10**9
TF, CLOUD = "tf2_msgs/msg/TFMessage", "sensor_msgs/msg/PointCloud2"


def said(path: Path, about: str) -> dict[str, str]:
    with path.open("rb") as file:
        return {
            key: value
            for record in make_reader(file).iter_metadata()
            for key, value in record.metadata.items()
            if key.startswith(about)
        }


@pytest.mark.parametrize(("start_s", "duration_s"), [(0.3, None), (0.0, 60.0)])
def test_the_recording(tmp_path: Path, start_s: float, duration_s: float | None) -> None:
    recording, out = parts(tmp_path, "mcap")[0], tmp_path / "out.mcap"
    lidcam.process(recording, out, settings=SMALL, start_s=start_s, duration_s=duration_s, workers=1)
    whole = recording.read_bytes()
    known = {"input.0.name": "0.mcap", "input.0.size": str(len(whole))}
    if duration_s == 60.0:
        known["input.0.sha256"] = sha256(whole).hexdigest()
    assert said(out, "input.") == known
    with open_result(out) as result:
        assert known.items() <= result.metadata.items()


# --- files that are changed while a run reads them


def clouds(first: int, last: int) -> Iterator[RawMessage]:
    if not first:
        yield raw("/tf_static", TF, tf_message([transform_stamped("base_link", "lidar", stamp_ns=START_NS)]), START_NS)
    for row in range(first, last):
        stamp_ns = START_NS + row * 100_000_000
        points = 10 * np.random.default_rng(row).random((500, 3))
        yield raw("/points", CLOUD, pointcloud2(points, stamp_ns=stamp_ns, frame_id="lidar"), stamp_ns)


def parts(folder: Path, kind: str) -> list[Path]:
    """A recording in two files."""
    found = []
    for row in (0, 1):
        path = folder / f"{row}"
        if kind == "mcap":
            write_mcap(path.with_suffix(".mcap"), clouds(5 * row, 5 * row + 5))
            found.append(path.with_suffix(".mcap"))
        else:
            write_rosbag2(path, clouds(5 * row, 5 * row + 5), "sqlite3", "file" if kind == "zstd" else "none")
            found += sorted(path.glob("*.db3*"))
    return found


class AtFirstFrame(RunObserver):
    def __init__(self, act: Callable[[], object]) -> None:
        self._act, self._is_done = act, False

    def frame(self, result: FrameResult) -> None:
        """Act once."""
        del result
        if not self._is_done:
            self._act()
            self._is_done = True


def replace_by_rename(path: Path) -> None:
    other = path.with_name("other")
    other.write_bytes(b"another recording")
    other.replace(path)


def append(path: Path) -> None:
    with path.open("ab") as file:
        file.write(b"more")


@pytest.mark.parametrize("kind", ["mcap", "zstd"])
@pytest.mark.parametrize("duration_s", [None, 0.7])
@pytest.mark.parametrize("change", [replace_by_rename, append])
def test_a_later_part_that_is_changed(
    tmp_path: Path, kind: str, duration_s: float | None, change: Callable[[Path], None]
) -> None:
    """The result names the content that was read, or says that nobody knows it."""
    first, second = parts(tmp_path, kind)
    checksums = [sha256(path.read_bytes()).hexdigest() for path in (first, second)]
    out = tmp_path / "out.mcap"
    job = make_job([first, second], out, settings=[CLUSTERS], workers=1, duration_s=duration_s)
    summary = process_recording(job, AtFirstFrame(lambda: change(second)))
    later = {key: value for key, value in said(out, "input.").items() if key[8:] in {"sha256", "changed"}}
    expected = {} if duration_s else {f"input.{row}.sha256": one for row, one in enumerate(checksums)}
    incomplete: tuple[str, ...] = ()
    if change is append:
        expected.pop("input.1.sha256", "")
        expected["input.1.changed"] = "while it was read"
        incomplete = (f"{second}: changed while it was read; run it again when nothing writes to it",)
    assert (summary.frames.count, later, summary.incomplete) == (7 if duration_s else 10, expected, incomplete)


def test_the_same_wherever_the_files_lie(tmp_path: Path) -> None:
    """No folder is in a result; a network of other content makes another recording id."""
    written: list[list[bytes]] = []
    for folder, value in (("alice", 0), ("bob/runs", 0), ("carol", 1)):
        here = tmp_path / folder
        here.mkdir(parents=True)
        model = write_yolox(here / "net.onnx", np.full((84, 85), value, np.float32), size_px=(64, 64))
        (here / "names.txt").write_text("\n".join(map(str, range(80))))
        files = {"detect2d.names": str(here / "names.txt"), "velodyne.calibration": str(here / "none.yaml")}
        outputs = [here / "out.mcap", here / "out.rrd"]
        lidcam.process(SANDBOX, outputs, model_2d=model, settings=files | SMALL, duration_s=0.1, workers=1)
        written.append([(here / name).read_bytes() for name in ("out.mcap", "out.foxglove.json", "out.rrd")])
        assert said(here / "out.mcap", "network.").keys() >= {"network.sha256", "network.names.sha256"}
    assert written[0][:2] == written[1][:2]
    first, same, other = (RRD_STORE.findall(rrd) for *_, rrd in written)  # Rerun puts times into the rest
    assert first == same
    assert first != other
    assert not any(trace in one for one in written[0] for trace in (b"alice", bytes(tmp_path)))
