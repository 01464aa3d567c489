"""Hostile names in every place that can carry one: nothing of them reaches a terminal but what can be seen.

Each case puts one payload (a sequence for a terminal, a line end, a mark of bidirectional text, markup...) in one place
of a recording, a rig, settings, a scenario, a file name or the command line, and runs a command on it, on a terminal or
not. Of what is printed and logged every character has to be printable, but for line ends and, on a terminal, the codes
that style text and draw the bar; no line may begin with what a payload says after a line end; JSON has to be JSON.
"""

import io
import json
import os
import pty
import re
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping
from contextlib import ExitStack, redirect_stderr, redirect_stdout
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from random import Random
from typing import Any

from common import LIDCAM, SEARCHED, Outcome, campaign, is_one_line  # isort: split

import numpy as np
import yaml
from builders import (
    camera_info,
    detection2d_array,
    image,
    pointcloud2,
    raw,
    tf_message,
    transform_stamped,
    write_mcap,
    write_rosbag1,
)
from logging_state import kept_logging
from small_scenario import small_scenario

from lidcam.cli import app
from lidcam.program import run_program
from pipeline.core.messages import Channel, RawMessage

__all__ = ["TEST_COUNT", "main"]

TEST_COUNT = 8
REAL_TERMINALS = 12
"""One case of so many runs in a process of its own, on a terminal of its own."""

BEFORE, AFTER, FAKED = "QZ", "ZQ", "lidcam: error: faked"
PAYLOADS = (
    "\x1b]52;c;ZXZpbA==\x07",  # the clipboard
    "\x1b]0;title\x07",
    "\x1b]8;;https://example.org\x1b\\link\x1b]8;;\x1b\\",
    "\x1b[2J\x1b[H",
    "\x1b[31m",
    "\x1bP$q\x1b\\",
    "\x1b[6n",
    "\x9b2J",
    "\x9d52;c;ZXZpbA==\x9c",
    "\x90q\x9c",
    "\x85" + FAKED,
    f"\n{FAKED}\n",
    f"\r{FAKED}",
    f"\r\n{FAKED}\r\n",
    f"\x0b{FAKED}\x0c{FAKED}",
    f"\u2028{FAKED}\u2029{FAKED}",
    "\b\b\b\b\b\b\b\b",
    "\x7f",
    "\x00",
    "\t\t\t",
    "\u202egnp.exe\u202c",
    "\u2066\u2067\u2069",
    "\u200b\u200d\ufeff\u2060",
    "\u00ad",
    "\u00a0",
    "\U000e0041",  # a tag
    "\ue000",
    "\ufffe",
    "[red]a[/red]",
    "[link=https://example.org]a[/link]",
    "[/]",
    ":smile:",
    "%s %d {0} {name} $HOME `id`",
    "\u5bbd\u5b57" * 9,  # wide
    "e\u0301" * 5,  # combining
    "a" * 300,
)
STYLES = re.compile(r"\x1b\[[0-9;]*m")
BAR = re.compile(r"\x1b\[(?:\?25[lh]|2K|1A)|\r")

STEP_NS = 100_000_000
START_NS = 1_700_000_000_000_000_000
FRAMES = 3


class _Terminal(io.TextIOWrapper):
    """A stream that says that it is a terminal."""

    is_terminal = False

    def isatty(self) -> bool:
        return self.is_terminal


@dataclass(frozen=True)
class Places:
    """The names of a case: harmless, but for those that carry the payload."""

    topic: str = "/points"
    image_topic: str = "/cam/image_raw"
    frame: str = "lidar"
    image_frame: str = "cam"
    encoding: str = "rgb8"
    distortion: str = "plumb_bob"
    box_class: str = "car"
    other_type: str = "some_msgs/msg/Other"
    other_topic: str = "/other"
    definition: str = "string data\n"
    file: str = "drive"
    folder: str = "in"


@dataclass(frozen=True)
class Printed:
    """What a command printed and logged."""

    out: str
    err: str
    log: str
    code: int


def recording(folder: Path, places: Places, container: str) -> Path:
    """A lidar, a camera without calibration or with, boxes, and a topic of a type of its own; one cloud is broken."""
    encoding = "ros1" if container == "bag" else "cdr"
    messages: list[RawMessage] = []

    def add(topic: str, msgtype: str, fields: Mapping[str, Any], stamp_ns: int) -> None:
        messages.append(raw(topic, msgtype, fields, stamp_ns, encoding=encoding))  # type: ignore[arg-type]

    edges = [transform_stamped(places.frame, places.image_frame, stamp_ns=START_NS)]
    add("/tf_static", "tf2_msgs/msg/TFMessage", tf_message(edges), START_NS)
    rng = np.random.default_rng(0)
    K = np.array([[50.0, 0, 32], [0, 50, 24], [0, 0, 1]])
    for number in range(FRAMES):
        stamp_ns = START_NS + number * STEP_NS
        cloud = pointcloud2(rng.uniform(-5, 5, (60, 3)), stamp_ns=stamp_ns, frame_id=places.frame)
        add(places.topic, "sensor_msgs/msg/PointCloud2", cloud, stamp_ns)
        pixels = image(np.zeros((48, 64, 3), np.uint8), stamp_ns=stamp_ns, frame_id=places.image_frame)
        add(places.image_topic, "sensor_msgs/msg/Image", {**pixels, "encoding": places.encoding}, stamp_ns)
        info = camera_info(
            K,
            stamp_ns=stamp_ns,
            width_px=64,
            height_px=48,
            frame_id=places.image_frame,
            distortion_model=places.distortion,
        )
        add("/cam/camera_info", "sensor_msgs/msg/CameraInfo", info, stamp_ns)
        boxes = detection2d_array(
            [[1, 1, 9, 9]],
            class_names=[places.box_class],
            scores=[0.9],
            stamp_ns=stamp_ns,
            frame_id=places.image_frame,
        )
        add("/cam/detections", "vision_msgs/msg/Detection2DArray", boxes, stamp_ns)
        definition_format = "ros1msg" if encoding == "ros1" else "ros2msg"
        other = Channel(places.other_topic, places.other_type, encoding, places.definition, definition_format)  # type: ignore[arg-type]
        messages.append(RawMessage(stamp_ns, stamp_ns, (0, 0), b"\1\0\0\0a", other))
    bad = max(row for row, message in enumerate(messages) if message.topic == places.topic)
    messages[bad] = messages[bad]._replace(data=bytes(messages[bad].data)[:-300])
    path = folder / f"{places.file}.{container}"
    if container == "bag":
        write_rosbag1(path, messages)
    else:
        write_mcap(path, messages)
    return path


NAMES = tuple(Places.__dataclass_fields__)
COMMANDS = ("process", "process", "process --json", "inspect", "inspect", "inspect --json")


def in_recording(chance: Random, name: str, folder: Path) -> list[str]:
    """A command on a recording in which some names are the payload's."""
    chosen = chance.sample(NAMES, chance.choice((1, 1, 1, 3, len(NAMES))))
    places = Places()
    for place in chosen:
        was = getattr(places, place)
        told = name.replace("/", "_").replace("\x00", "")[:60] if place in {"file", "folder"} else name
        if place == "definition":
            value = f"string {told}\n# {told}\n"
        elif place == "other_type":
            value = f"some_msgs/msg/{told}"
        else:
            value = f"{was}{told}"
        places = replace(places, **{place: value})
    container = chance.choice(("bag", "mcap"))
    inside = folder / places.folder
    inside.mkdir()
    try:
        path = recording(inside, places, container)
    except Exception:  # a name that the writer of bags refuses
        path = recording(inside, Places(), "mcap")
    command, *options = chance.choice(COMMANDS).split()
    words = [command, str(path)]
    if command == "process":
        words += [str(inside / f"{places.file}.out.mcap"), "--set", "combine.outliers.enabled=false"]
        words += ["--rerun", str(inside / "out.rrd")] * (chance.random() < 0.1)
        words += ["--print-detections", "--print-matches"] * (not options and chance.random() < 0.2)
    elif chance.random() < 0.2:
        words += ["--write-rig", str(inside / f"{places.file}.yaml")]
    return words + options


def in_rig(chance: Random, name: str, folder: Path) -> list[str]:
    """A rig file that carries the payload as a name, a key or a value."""
    sensor = {"topic": "/points", "T_site_lidar": np.eye(4).tolist()}
    tree = chance.choice(
        (
            {"site_frame": name, "lidars": {"lidar": sensor}},
            {"site_frame": "s", "lidars": {name: sensor}},
            {"site_frame": "s", "lidars": {"lidar": sensor | {"topic": name}}},
            {"site_frame": "s", "lidars": {"lidar": sensor | {name: 1}}},
            {"site_frame": "s", "lidars": {"lidar": sensor | {"T_site_lidar": name}}},
            {"site_frame": "s", "lidars": {"lidar": sensor}, "zones": {name: [[0, 0], [1, 0], [1, 1]]}},
            {"site_frame": "s", "lidars": {"lidar": sensor}, "cameras": {"cam": {"K": name}}},
            {name: name},
        )
    )
    path = folder / "rig.yaml"
    path.write_text(yaml.safe_dump(tree), encoding="utf-8")
    return [*_on_sound(chance, folder), "--rig", str(path)]


def in_settings(chance: Random, name: str, folder: Path) -> list[str]:
    """Settings that carry the payload as a key, a value, or in a comment."""
    path = folder / "settings.yaml"
    tree = chance.choice(({name: 1}, {"fuse": {name: 1}}, {"fuse": {"min_score": name}}, {"classes": [{"name": name}]}))
    comment = "".join(letter for letter in name if letter in "\t\r\x85" or letter.isprintable())
    path.write_bytes(f"# {comment}\n{yaml.safe_dump(tree)}".encode(errors="replace"))
    pair = chance.choice((f"{name}=1", f"fuse.{name}=1", f"fuse.min_score={name}", name, f"topics.lidars=[{name}]"))
    on_sound = _on_sound(chance, folder)
    return chance.choice(
        (
            ["config", "show", str(path), "--changes"],
            ["config", "show", str(path)],
            ["config", "show", name],
            ["config", "explain", name],
            ["config", "explain", f"fuse.{name}", "--json"],
            [*on_sound, "--config", str(path)],
            [*on_sound, "--config", name],
            [*on_sound, "--set", pair.replace("\x00", "")],
        )
    )


def in_scenario(chance: Random, name: str, folder: Path) -> list[str]:
    """A scenario with an error that quotes the payload."""
    tree = small_scenario()
    change: Callable[[dict[str, object]], object] = chance.choice(
        (
            lambda tree: tree.update({name: 1}),
            lambda tree: tree.update({"world": name}),
            lambda tree: tree["lidars"]["top"].update({"firing_stride": name}),
            lambda tree: tree["vehicles"].update({name: {"shape": "no_such"}}),
            lambda tree: tree["vehicles"]["car1"].update({"route": name}),
        )
    )
    change(tree)
    path = folder / "scenario.yaml"
    path.write_text(yaml.safe_dump(tree), encoding="utf-8")
    what = chance.choice((str(path), str(path), name.replace("\x00", "")))
    command = chance.choice(("simulate", "drive"))
    return [command, what, str(folder / "out.bag")] + ["--keys", name.replace("\x00", "")] * (command == "drive")


def in_command_line(chance: Random, name: str, folder: Path) -> list[str]:
    """Wrong usage, files that do not exist, and addresses, that are quoted."""
    name = name.replace("\x00", "")
    flat = name.replace("/", "_")[:80]
    return chance.choice(
        (
            [name],
            ["process", f"{folder}/{flat}.bag", f"{folder}/{flat}.txt"],
            ["process", f"{folder}/{flat}.bag", f"{folder}/out.mcap"],
            ["process", "--" + name],
            ["process", "a.bag", "b.mcap", "--workers", name],
            ["process", "a.bag", "b.mcap", "--on-bad-message", name],
            ["process", "a.bag", "b.mcap", "--start", name],
            ["inspect", f"http://127.0.0.1:9/{name}.mcap"],
            ["inspect", f"ftp://{name}/a.mcap"],
            ["inspect", f"{name}://a.mcap"],
            ["inspect", name],
            ["inspect", f"{folder}/\udcff{flat}.bag"],
            ["inspect", "a.bag", "--log-file", f"{folder}/{flat}"],
            ["inspect", "a.bag", "--rig", f"{folder}/{flat}.yaml"],
            ["process", "a.bag", f"{folder}/{flat}/out.mcap"],
            ["process", "a.bag", f"{folder}/out.mcap", "--model-2d", f"{folder}/{flat}.onnx"],
            ["demo", f"/dev/null/{name}"],
        )
    )


KINDS = (in_recording, in_recording, in_recording, in_rig, in_settings, in_scenario, in_command_line, in_command_line)


def _on_sound(chance: Random, folder: Path) -> list[str]:
    path = recording(folder, Places(), "mcap")
    return chance.choice((["inspect", str(path)], ["process", str(path), str(folder / "out.mcap")]))


def run_here(words: list[str], folder: Path, *, on_terminal: bool) -> Printed:
    """The command in this process, which takes a tenth of the time of one of its own."""
    streams = [_Terminal(io.BytesIO(), encoding="utf-8", errors="strict", newline="") for _ in range(2)]
    for stream in streams:
        stream.is_terminal = on_terminal
    handlers = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGHUP, signal.SIGINT)}
    arguments, here = sys.argv, Path.cwd()
    code = 0
    with ExitStack() as stack:
        stack.enter_context(kept_logging())
        stack.enter_context(redirect_stdout(streams[0]))
        stack.enter_context(redirect_stderr(streams[1]))
        sys.argv = ["lidcam", *words]
        os.chdir(folder)
        try:
            run_program(app, "lidcam")
        except SystemExit as end:
            code = int(end.code or 0)
        finally:
            sys.argv = arguments
            os.chdir(here)
            for number, handler in handlers.items():
                signal.signal(number, handler)
    written = []
    for stream in streams:
        stream.flush()
        assert isinstance(stream.buffer, io.BytesIO)
        written.append(stream.buffer.getvalue().decode())
    return Printed(written[0], written[1], _logged(folder), code)


def run_on_a_terminal(words: list[str], folder: Path) -> Printed:
    """The command in a process of its own on a terminal of its own, which sees both outputs."""
    ours, theirs = pty.openpty()
    env = os.environ | {"PYTHONPATH": SEARCHED[0], "TERM": "xterm-256color", "COLUMNS": "100", "LC_ALL": "C.UTF-8"}
    child = subprocess.Popen(
        [*LIDCAM, *words], stdin=subprocess.DEVNULL, stdout=theirs, stderr=theirs, cwd=folder, env=env
    )
    os.close(theirs)
    chunks = []
    while True:
        try:
            chunk = os.read(ours, 1 << 16)
        except OSError:  # Linux says so where a terminal has closed
            break
        if not chunk:
            break
        chunks.append(chunk)
    os.close(ours)
    text = b"".join(chunks).decode(errors="surrogateescape").replace("\r\n", "\n")
    return Printed(text, "", _logged(folder), child.wait())


def _logged(folder: Path) -> str:
    log = folder / "run.log"
    return log.read_text(encoding="utf-8") if log.exists() else ""


def fault(printed: Printed, payload: str, *, on_terminal: bool, is_json: bool) -> str:
    """What is wrong with what was printed; empty if nothing is."""
    for name, text in (("stdout", printed.out), ("stderr", printed.err), ("log", printed.log)):
        text = text.partition("Traceback (most recent call last)")[0]
        if on_terminal and name != "log":
            text = BAR.sub("", STYLES.sub("", text))
        if found := next((letter for letter in text if letter != "\n" and not letter.isprintable()), ""):
            place = text.index(found)
            return f"{name}: {found!r} in {text[max(place - 60, 0) : place + 60]!r}"
        if not payload.isprintable() and f"{BEFORE}{payload}{AFTER}" in text:
            return f"{name}: the payload as it is"
        if not on_terminal and any(line.startswith(FAKED) for line in text.splitlines()):
            return f"{name}: a faked line"
        if "[" in payload and (f"{BEFORE}a{AFTER}" in text or f"{BEFORE}{AFTER}" in text):
            return f"{name}: markup was taken for markup"
    if "Traceback" in printed.out + printed.err:
        return f"a traceback: {(printed.out + printed.err)[-600:]}"
    if is_json and not on_terminal and printed.out:
        json.loads(printed.out)
    if printed.code == 1 and not on_terminal and printed.err:
        last = printed.err.splitlines()[-1]
        if not is_one_line(f"{last}\n"):
            return f"stderr: {last[:200]!r}"
    return ""


def try_case(number: int, chance: Random) -> Outcome:
    """Run one command with one payload in one place."""
    payload = chance.choice(PAYLOADS)
    if chance.random() < 0.3:
        payload += chance.choice(PAYLOADS)
    kind = chance.choice(KINDS)
    on_terminal = chance.random() < 0.4
    is_real = chance.randrange(REAL_TERMINALS) == 0 and number >= TEST_COUNT
    with tempfile.TemporaryDirectory(prefix="lidcam-terminal-") as name:
        folder = Path(name)
        words = kind(chance, f"{BEFORE}{payload}{AFTER}", folder)
        is_wrong = words[0] not in {"process", "inspect", "config", "simulate", "drive"} or "--log-file" in words
        words += [] if is_wrong else [*["-v"] * (chance.random() < 0.3), "--log-file", str(folder / "run.log")]
        words = [word.replace("\x00", "") for word in words]  # no system passes it on
        here = partial(run_here, on_terminal=on_terminal)
        printed = (run_on_a_terminal if is_real else here)(words, folder)
    wrong = fault(printed, payload, on_terminal=on_terminal or is_real, is_json="--json" in words)
    where = "a terminal" if is_real else "as on a terminal" if on_terminal else "no terminal"
    if wrong:
        shown = f"{words!r}\n{wrong}\nstdout: {printed.out!r}\nstderr: {printed.err!r}"
        return Outcome(
            f"let through: {kind.__name__}, {words[0]}"[:60].encode("ascii", "replace").decode(), True, shown
        )
    return Outcome(f"visible: {kind.__name__}, {where}, exit code {printed.code}")


def main(arguments: list[str] | None = None) -> int:
    """Run the campaign."""
    return campaign("terminal", try_case, count=400, arguments=arguments)


if __name__ == "__main__":
    sys.exit(main())
