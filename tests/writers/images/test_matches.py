"""Images of cameras, read back by Pillow."""

import json
from dataclasses import replace
from pathlib import Path

from frames import CONFIG, PROVENANCE, RIG, frame
from PIL import Image

from lidcam.readers.messages.image import decode_any_image
from lidcam.writers.images.matches import MatchesWriter
from lidcam.writers.images.scene import Scenes
from lidcam.writers.outputs.transaction import OutputFile


def test_one_file_per_camera_and_frame(tmp_path: Path) -> None:
    rig = replace(RIG, cameras=(replace(RIG.cameras[0], name="\u524d left/1"), RIG.cameras[1]))
    first = frame(0)
    renamed = {"\u524d left/1": first.views["left"], "right": first.views["right"]}
    first = replace(first, views=renamed)
    none = replace(first.bundle, index=1, messages={})
    without = replace(first, bundle=none, detections=replace(first.detections, cameras={}))
    folder = tmp_path / "images"
    with MatchesWriter(OutputFile(folder, folder), Scenes(rig, CONFIG, decode_any_image), PROVENANCE) as writer:
        drops = writer.write(first)
        assert writer.write(without) == ()
    right = first.bundle.messages["/right/image"]
    facts = [(drop.topic, drop.stamp_ns, drop.reason) for drop in drops]
    assert facts == [("/right/image", right.stamp_ns, "the image cannot be shown")]
    assert {file.name for file in folder.iterdir()} == {
        f"frame_000000_{name}.jpg" for name in ("right", "\u524d_left_1")
    }
    with Image.open(folder / "frame_000000_\u524d_left_1.jpg") as image:
        assert image.size == (640, 480)
        mark, _, facts = image.info["comment"].decode().partition(" ")
    known = json.loads(facts)
    assert mark == "lidcam.matches"
    assert (known["camera"], known["frame"], known["version"]) == ("\u524d left/1", 0, "1.2.3")
    assert known["stamp_ns"] == first.bundle.stamp_ns
