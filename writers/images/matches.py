"""Writes one JPEG per camera and frame into a folder: what each sensor saw, and what belongs together."""

import json
import re
from contextlib import ExitStack

from PIL import Image

from lidcam.pipeline.core.frame import FrameResult
from lidcam.pipeline.core.messages import Drop
from lidcam.writers.base import ResultWriter
from lidcam.writers.images.scene import Scenes
from lidcam.writers.outputs.errors import output_errors
from lidcam.writers.outputs.marks import MATCHES
from lidcam.writers.outputs.transaction import OutputFile
from lidcam.writers.provenance import Provenance

JPEG_QUALITY, MAX_COMMENT = 90, 65_000


class MatchesWriter(ResultWriter):
    """Writes `frame_NUMBER_CAMERA.jpg` of each image.

    A comment in each file has, as JSON, camera, frame, `stamp_ns` and where the result comes from
    (`Provenance.metadata`).
    """

    name = "matches"

    def __init__(self, output: OutputFile, scenes: Scenes, provenance: Provenance) -> None:
        self.path, self._output, self._scenes, self._origin = output.path, output, scenes, provenance.metadata()

    def _open(self, resources: ExitStack) -> None:  # noqa: ARG002
        self._output.part.mkdir()

    def write(self, result: FrameResult) -> tuple[Drop, ...]:
        """Write the images of one frame; returns those that cannot be decoded, which are drawn dark."""
        scene, bundle = self._scenes.add_frame(result), result.bundle
        drops: list[Drop] = []
        for name, shown in scene.images.items():
            if shown is not result:
                continue
            image, unfit = self._scenes.camera(scene, name)
            drops += unfit
            facts = {"camera": name, "frame": bundle.index, "stamp_ns": bundle.stamp_ns, **self._origin}
            label, comment = re.sub(r"[^\w.-]", "_", name), f"{MATCHES} {json.dumps(facts)}"
            path = self._output.part / f"frame_{bundle.index:06d}_{label}.jpg"
            with output_errors(self.path), path.open("xb") as file:
                Image.fromarray(image).save(file, "JPEG", quality=JPEG_QUALITY, comment=comment[:MAX_COMMENT])
        return tuple(drops)
