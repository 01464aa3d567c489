"""Kills at every moment and runs with one OUT: outputs are whole, the main one comes last, and the next run cleans up.

Every ninth case starts two runs with one output; the others kill a run, half of them at one of the system calls by
which outputs get their names, and look at what stands there, at once and after a next run that fails or succeeds.
"""

import os
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from hashlib import sha256
from pathlib import Path
from random import Random
from typing import Any

from common import Outcome, campaign

TEST_COUNT = 4
COUNT = 450
IN_CHILD = "LIDCAM_CAMPAIGN_CHILD"
SIGNALS = (signal.SIGKILL, signal.SIGKILL, signal.SIGTERM, signal.SIGINT, signal.SIGHUP)
CALLS = ("rename", "replace", "link", "unlink", "mkdir", "rmdir", "fsync", "chmod")
MAX_CALLS = 75
"""About as many of these as a run makes."""

RERUN = Path(sys.executable).with_name("rerun")


@dataclass(frozen=True)
class Kind:
    """What is run: its outputs, and how often it is tried."""

    name: str
    outputs: tuple[str, ...]
    share: int


KINDS = (
    Kind("process", ("out.mcap", "out.rrd", "out.foxglove.json"), 4),
    Kind("inspect", ("fixed.mcap", "rig.yaml"), 1),
    Kind("bag", ("sim.bag", "sim.bag.rig.yaml", "sim.bag.scenario.yaml"), 1),
    Kind("folder", ("sim", "sim.rig.yaml", "sim.scenario.yaml"), 2),
)


@cache
def home() -> Path:
    """A folder with the recordings, and with the outputs of undisturbed runs."""
    from forked_runs import load

    load()
    folder = Path(tempfile.mkdtemp(prefix="lidcam-outputs-"))
    write_recording(folder / "rec.mcap", "/points")
    write_recording(folder / "old.mcap", "/old/points")
    return folder


@cache
def made(kind: Kind, version: str) -> Path:
    """A folder with the outputs of an undisturbed run."""
    folder = home() / f"{kind.name}.{version}"
    folder.mkdir()
    ended = begin(kind, version, folder, home() / "rec.mcap").wait()
    assert ended.code == 0, ended.err
    assert names(folder) == sorted(kind.outputs), names(folder)
    return folder


def write_recording(path: Path, topic: str) -> None:
    import numpy as np
    from builders import pointcloud2, raw, write_mcap

    points = np.random.default_rng(0).uniform([5, -5, -1], [15, 5, 1], (200, 3)).astype(np.float32)
    clouds = [
        raw(topic, "sensor_msgs/msg/PointCloud2", pointcloud2(points, stamp_ns=i, frame_id="lidar"), i)
        for i in range(10**8, 9 * 10**8, 10**8)
    ]
    write_mcap(path, clouds)


@contextmanager
def recording(path: Path, format: Any, texts: dict[str, str]) -> Iterator[Any]:
    """A simulated recording."""
    from bags.simulator.recorder import files

    write: Any = files.recording_file
    from lidcam.outputs.allowed import SIMULATED, check_replaced

    check = check_replaced(lambda _: SIMULATED, overwrite=False)
    with (
        files.recording_outputs(path, format, check_old=check) as outputs,
        write(outputs, path, format, **texts) as writer,
    ):
        yield writer


def simulate(path: Path, format: Any, version: str) -> Callable[[], None]:
    """Writes a recording as `lidcam simulate` does, without a simulation, which takes long to load."""

    def work() -> None:
        from bags.simulator.recorder import files
        from bags.simulator.recorder.messages import MessageFactory
        from lidcam.program import run_program

        def record(*_: object, **__: object) -> None:
            make = MessageFactory(files.ros_version_of(format), 0)
            texts = {"rig_yaml": f"site_frame: {version}\n", "scenario_yaml": f"world: {version}\n"}
            with recording(path, format, texts) as writer:
                write(make, writer)

        def write(make: MessageFactory, writer: files.MessageWriter) -> None:
            for number in range(300 if version == "new" else 200):
                writer.write(make.recorded(number, "/wheel", number, make.number(number)), 0)

        run_program(record, "lidcam")

    return work


def begin(kind: Kind, version: str, folder: Path, recorded: Path, prepare: Callable[[], object] = lambda: None) -> Any:
    """Start a run; the new version has a longer part of the recording, a failing one none of it."""
    from forked_runs import start, started_lidcam

    err = folder.with_name(f"{folder.name}.{version}.err")
    out = [folder / name for name in kind.outputs]
    part = {"old": ["--duration", "0.3"], "new": [], "failing": ["--start", "1000"]}[version]
    if kind.name == "process":
        return started_lidcam(
            ["process", recorded, out[0], "--rerun", out[1], "--workers", "1", "-q", *part], err, prepare
        )
    if kind.name == "inspect":
        settings = ["--rig", "none.yaml"] if version == "failing" else []
        recorded = recorded.with_name("old.mcap") if version == "old" else recorded
        return started_lidcam(
            ["inspect", recorded, "--repair", out[0], "--write-rig", out[1], "-q", *settings], err, prepare
        )
    format: Any = "ros1" if kind.name == "bag" else "sqlite3"
    if version == "failing":

        def fail() -> None:
            from lidcam.program import run_program
            from pipeline.core.errors import ConfigError

            def work(*_: object, **__: object) -> None:
                with recording(out[0], format, {"rig_yaml": "", "scenario_yaml": ""}):
                    raise ConfigError("fails")

            run_program(work, "lidcam")

        return start(fail, err)
    work = simulate(out[0], format, version)

    def prepared() -> None:
        prepare()
        work()

    return start(prepared, err)


def names(folder: Path) -> list[str]:
    """What lies in a folder, hidden or not."""
    return sorted(path.name for path in folder.iterdir())


def content(path: Path) -> str | None:
    """A checksum of a file, or of a folder with its files."""
    if path.is_dir():
        return " ".join(f"{file.name} {content(file)}" for file in sorted(path.iterdir()))
    return sha256(path.read_bytes()).hexdigest() if path.is_file() else None


def version_of(kind: Kind, name: str, folder: Path, before: dict[str, str | None]) -> str:
    """`before`, `new`, or what else stands under a final name."""
    found, new = content(folder / name), content(made(kind, "new") / name)
    if found == before[name]:
        return "before or new" if found == new else "before"
    if found == new:
        return "new"
    if found is None:
        return "nothing"
    if name.endswith(".rrd"):  # never the same bytes
        verified = subprocess.run([RERUN, "rrd", "verify", folder / name], capture_output=True, check=False)
        least = (made(kind, "new") / name).stat().st_size * 0.9
        if verified.returncode == 0 and (folder / name).stat().st_size > least:
            return "new"
    return "broken"


def killed_at(calls: int, number: int, *, is_before: bool) -> Callable[[], None]:
    """Has a process send itself a signal at one of the calls by which outputs get their names."""

    def prepare() -> None:
        left = [calls]

        def counted(name: str) -> None:
            real = getattr(os, name)

            def call(*arguments: object, **options: object) -> object:
                left[0] -= 1
                if left[0] == 0 and is_before:
                    os.kill(os.getpid(), number)
                result = real(*arguments, **options)
                if left[0] == 0 and not is_before:
                    os.kill(os.getpid(), number)
                return result

            setattr(os, name, call)

        for name in CALLS:
            counted(name)

    return prepare


def try_kill(folder: Path, chance: Random) -> Outcome:
    """Kill a run, look, run again, look."""
    kind = chance.choices(KINDS, [kind.share for kind in KINDS])[0]
    has_old = chance.random() < 0.6
    if has_old:
        shutil.copytree(made(kind, "old"), folder, dirs_exist_ok=True)
    before = {name: content(folder / name) for name in kind.outputs}
    number, is_at_call = chance.choice(SIGNALS), chance.random() < 0.5
    recording = home() / "rec.mcap"
    if is_at_call:
        calls = chance.randint(1, MAX_CALLS if kind.name == "process" else MAX_CALLS * 2 // 3)
        prepare = killed_at(calls, number, is_before=chance.random() < 0.5)
        run = begin(kind, "new", folder, recording, prepare).wait()
        when = f"at call {calls}"
    else:
        after_s = chance.uniform(0, 1.0)
        started = begin(kind, "new", folder, recording)
        started.send(number, after_s)
        run = started.wait()
        when = f"after {after_s:.3f} s"
    told = (
        f"{kind.name}, old outputs {has_old}, {signal.Signals(number).name} {when}: exit code {run.code}\n{run.err}\n"
    )

    def look() -> tuple[list[str], list[str]]:
        versions = [version_of(kind, name, folder, before) for name in kind.outputs]
        return [version for version in versions if version != "before or new"], names(folder)

    def fault(what: str) -> Outcome:
        return Outcome(what, is_fault=True, detail=f"{told}{look()}")

    versions, seen = look()
    is_known = set(kind.outputs)
    leftovers = [name for name in seen if name not in is_known]
    if run.is_hung:
        return fault("hang after a signal")
    if "Traceback" in run.err:
        return fault("traceback after a signal")
    if set(versions) - {"before", "new"}:
        return fault("a file under a final name is neither old nor new")
    if versions[0] == "new" and set(versions) != {"new"}:
        return fault("the main output is new, others are not")
    if number != signal.SIGKILL or run.code == 0:
        if len(set(versions)) != 1:
            return fault("outputs are not together after a run that ended itself")
        if leftovers and run.code != -number:
            return fault("leftovers of a run that ended itself")
        if run.code == 0 and versions[0] != "new":
            return fault("exit code 0 without the outputs")
    is_failing = chance.random() < 0.5
    if is_failing:
        begin(kind, "failing", folder, recording).wait()
        versions, seen = look()
        if set(versions) - {"before", "new"}:
            return fault("a file under a final name is neither old nor new after the next run")
        if set(seen) - is_known:
            return fault("leftovers after the next run")
    again = begin(kind, "new", folder, recording).wait()
    told += f"next: {again.code}\n{again.err}\n"
    versions, seen = look()
    if again.code != 0 or (set(versions) != {"new"}):
        return fault("the next run failed")
    if seen != sorted(kind.outputs):
        return fault("leftovers after the next run")
    ended = {0: "had ended", -number: "killed"}.get(run.code, "ended itself")
    return Outcome(f"{signal.Signals(number).name} {'at a call' if is_at_call else 'at a time'}: {ended}")


def try_pair(folder: Path, chance: Random) -> Outcome:
    """Two runs with one OUT, or with one .rrd, at the same time."""
    from forked_runs import started_lidcam

    shared = chance.choice(["all", "link", "rrd"])
    (folder / "link").symlink_to(".")
    firsts: list[Path] = [folder / "out.mcap", folder / "out.rrd"]
    seconds = {
        "all": firsts,
        "link": [folder / "link" / "out.mcap", folder / "link" / "out.rrd"],
        "rrd": [folder / "other.mcap", folder / "out.rrd"],
    }[shared]
    recording = home() / "rec.mcap"
    runs = []
    for number, (mcap, rrd) in enumerate((firsts, seconds)):
        err = folder.with_name(f"{folder.name}.{number}.err")
        runs.append(started_lidcam(["process", recording, mcap, "--rerun", rrd, "--workers", "1", "-q"], err))
        if number == 0:
            runs[0].send(0, chance.uniform(0, 0.4))
    ended = [run.wait() for run in runs]
    told = f"{shared}: {[(one.code, one.err) for one in ended]}\n{names(folder)}"
    kind = KINDS[0]
    nothing: dict[str, str | None] = dict.fromkeys(kind.outputs)
    wanted = ["link", *kind.outputs] if ended[0].code == 0 else ["link", *kind.outputs[:0]]
    versions = {name: version_of(kind, name, folder, nothing) for name in kind.outputs}
    if any(one.is_hung for one in ended):
        return Outcome("pair: hang", is_fault=True, detail=told)
    if shared != "rrd" and set(versions.values()) != {"new"}:
        return Outcome("pair: an output is not whole", is_fault=True, detail=f"{told} {versions}")
    if version_of(kind, "out.rrd", folder, nothing) != "new":
        return Outcome("pair: an output is not whole", is_fault=True, detail=f"{told} {versions}")
    if [name for name in names(folder) if name.startswith(".") or name.endswith(".part")]:
        return Outcome("pair: leftovers", is_fault=True, detail=told)
    codes = sorted(one.code for one in ended)
    if codes == [0, 0]:
        # The second may begin to write when the first has ended; it was not refused then.
        return Outcome("pair: one after the other")
    loser = next(one for one in ended if one.code != 0)
    if codes != [0, 1] or not loser.is_one_line or "is being written by another run (process" not in loser.err:
        return Outcome("pair: the second did not end with its line", is_fault=True, detail=told)
    if shared == "rrd" and len([name for name in ("out.mcap", "other.mcap") if (folder / name).exists()]) != 1:
        return Outcome("pair: outputs of the refused run", is_fault=True, detail=f"{told} {wanted}")
    return Outcome("pair: the second was refused")


def try_case(number: int, chance: Random) -> Outcome:
    """One case in a folder of its own."""
    base = Path(tempfile.mkdtemp(dir=home()))
    folder = base / "out"
    folder.mkdir()
    try:
        return try_pair(folder, chance) if number % 9 == 0 else try_kill(folder, chance)
    finally:
        shutil.rmtree(base)


def main(arguments: Sequence[str] | None = None) -> int:
    """The exit code; runs in a process of its own, which forks for every case."""
    given = sys.argv[1:] if arguments is None else list(arguments)
    if IN_CHILD not in os.environ:
        command = [sys.executable, __file__, *given]
        return subprocess.run(command, env=os.environ | {IN_CHILD: "1"}, check=False).returncode
    try:
        return campaign("outputs", try_case, count=COUNT, arguments=given)
    finally:
        shutil.rmtree(home(), ignore_errors=True)


if __name__ == "__main__":
    sys.exit(main())
