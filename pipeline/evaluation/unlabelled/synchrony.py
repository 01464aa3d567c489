"""How well the sensors of a frame agree in time, and how often a camera is missing."""

from collections.abc import Sequence

import numpy as np

from pipeline.evaluation.records import EvaluationFrame, Figures

__all__ = ["Synchrony"]


class Synchrony:
    """Skews of all frames, and frames without each camera.

    Args:
        cameras: Names of the cameras.
    """

    def __init__(self, cameras: Sequence[str]) -> None:
        self._skews_ns: list[int] = []
        self._frames = 0
        self._missing = dict.fromkeys(cameras, 0)

    def add(self, frame: EvaluationFrame) -> None:
        """Take in one frame."""
        self._frames += 1
        if frame.skew_ns is not None:
            self._skews_ns.append(frame.skew_ns)
        for camera in self._missing:
            self._missing[camera] += camera not in frame.images

    def figures(self) -> Figures:
        """Skews in milliseconds; the share of frames without each camera."""
        skews_ms = np.array(self._skews_ns, np.float64) / 1e6
        some = len(skews_ms) > 0
        return {
            "frames": self._frames,
            "frames_without_skew": self._frames - len(skews_ms),
            "skew_mean_ms": float(skews_ms.mean()) if some else None,
            "skew_p50_ms": float(np.percentile(skews_ms, 50)) if some else None,
            "skew_p95_ms": float(np.percentile(skews_ms, 95)) if some else None,
            "skew_max_ms": float(skews_ms.max()) if some else None,
            "cameras": {
                camera: {"missing_share": count / self._frames if self._frames else None}
                for camera, count in self._missing.items()
            },
        }
