"""Recorded lidar and camera topics in, fused objects out.

    import lidcam

    run = lidcam.process("drive.bag", "out.mcap", model_2d="yolox_nano.onnx")
    run.objects.to_pandas()

Names are loaded when they are first used, so `import lidcam` is instant.
"""

from importlib import import_module
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

from lidcam.packages import check_own_packages

if TYPE_CHECKING:
    from lidcam.api import (
        RunResult,
        inspect,
        iter_frames,
        load_config,
        load_rig,
        open_recording,
        process,
    )
    from lidcam.inspection import Inspection
    from lidcam.job import Job, make_job
    from lidcam.objects import Objects
    from lidcam.run import RunObserver, process_recording
    from lidcam.summary import DropCount, RunReport
    from pipeline.core.clouds import CombinedCloud, PointCloud
    from pipeline.core.detections import Boxes2D, Boxes3D, Detections, Fused, Matches
    from pipeline.core.errors import (
        CalibrationError,
        ConfigError,
        FrameError,
        LidcamError,
        MessageError,
        ModelError,
        OutputError,
        RecordingError,
    )
    from pipeline.core.frame import FrameResult, SensorBundle
    from pipeline.core.messages import RawMessage
    from pipeline.core.rig import Rig
    from pipeline.core.settings.config import Config
    from readers.recording import Recording

__version__ = version("lidcam")

_HOMES = {
    "lidcam.api": (
        "RunResult",
        "inspect",
        "iter_frames",
        "load_config",
        "load_rig",
        "open_recording",
        "process",
    ),
    "lidcam.inspection": ("Inspection",),
    "lidcam.job": ("Job", "make_job"),
    "lidcam.objects": ("Objects",),
    "lidcam.run": ("RunObserver", "process_recording"),
    "lidcam.summary": ("DropCount", "RunReport"),
    "pipeline.core.clouds": ("CombinedCloud", "PointCloud"),
    "pipeline.core.detections": ("Boxes2D", "Boxes3D", "Detections", "Fused", "Matches"),
    "pipeline.core.errors": (
        "CalibrationError",
        "ConfigError",
        "FrameError",
        "LidcamError",
        "MessageError",
        "ModelError",
        "OutputError",
        "RecordingError",
    ),
    "pipeline.core.frame": ("FrameResult", "SensorBundle"),
    "pipeline.core.messages": ("RawMessage",),
    "pipeline.core.rig": ("Rig",),
    "pipeline.core.settings.config": ("Config",),
    "readers.recording": ("Recording",),
}
_HOME_OF = {name: home for home, names in _HOMES.items() for name in names}

__all__ = [
    "Boxes2D",
    "Boxes3D",
    "CalibrationError",
    "CombinedCloud",
    "Config",
    "ConfigError",
    "Detections",
    "DropCount",
    "FrameError",
    "FrameResult",
    "Fused",
    "Inspection",
    "Job",
    "LidcamError",
    "Matches",
    "MessageError",
    "ModelError",
    "Objects",
    "OutputError",
    "PointCloud",
    "RawMessage",
    "Recording",
    "RecordingError",
    "Rig",
    "RunObserver",
    "RunReport",
    "RunResult",
    "SensorBundle",
    "__version__",
    "inspect",
    "iter_frames",
    "load_config",
    "load_rig",
    "make_job",
    "open_recording",
    "process",
    "process_recording",
]


if not TYPE_CHECKING:  # a type checker knows the names from above, and no others

    def __getattr__(name: str) -> Any:
        if name not in _HOME_OF:
            raise AttributeError(f"module 'lidcam' has no attribute {name!r}")
        check_own_packages()
        value = getattr(import_module(_HOME_OF[name]), name)
        globals()[name] = value
        return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
