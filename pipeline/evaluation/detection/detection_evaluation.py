"""Detection: what each source found, against the truth."""

from collections.abc import Sequence

import numpy as np

from lidcam.pipeline.core.rig import Zone
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.evaluation.detection.camera_images import CameraImages
from lidcam.pipeline.evaluation.detection.fusion_gain import fusion_gain
from lidcam.pipeline.evaluation.detection.gathering import Gathering
from lidcam.pipeline.evaluation.detection.resampling import Resampling
from lidcam.pipeline.evaluation.detection.source import Site, Source
from lidcam.pipeline.evaluation.evaluation_frame import EvaluationFrame, Figures, in_order


class DetectionEvaluation:
    """Compares the detections of every source with the truth; see `Gathering`. Keeps about 150 bytes of each box."""

    def __init__(self, config: Config, zones: Sequence[Zone]) -> None:
        self._config, self._zones = config, tuple(zones)
        self._gathering = Gathering(config, zones)
        self._images: dict[str, CameraImages] = {}

    def add_frame(self, frame: EvaluationFrame) -> None:
        """Take in one frame."""
        self._gathering.add_frame(frame)
        for camera, image in frame.images.items():
            self._images.setdefault(camera, CameraImages(self._config)).add_image(image)

    def figures(self) -> Figures:
        """The figures of all frames: `sources`, `images`, `fusion_gain`."""
        found = self._gathering.found()
        site = Site.of(self._config, self._zones, self._gathering)
        sources = {name: Source(site, found[name]) for name in in_order(found)}
        figures = {name: source.figures() for name, source in sources.items()}
        stamps_ns = np.array(self._gathering.stamps_ns, np.int64)
        gain = fusion_gain(sources, figures, Resampling.of(stamps_ns)) if len(stamps_ns) else {}
        return {
            "sources": figures,
            "images": {camera: self._images[camera].figures() for camera in sorted(self._images)},
            "fusion_gain": gain,
        }
