"""The settings that affect a result or an evaluation."""

from collections.abc import Sequence
from hashlib import sha256
from os.path import isfile
from pathlib import Path

from lidcam.networks.known import fetched_network, network_path
from lidcam.pipeline.core.errors import ConfigError
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.core.settings.load import dump_config
from lidcam.pipeline.core.text import visible
from lidcam.pipeline.detectors.pillars.embedded import network_file

EVALUATING = ("evaluate", "classes", "combine", "limit_scale")
"""The sections that an evaluation reads, `combine` for odometry."""

NAMED = (
    *(("detect2d", "model"), ("detect2d", "names"), ("detect3d", "model"), ("detect3d", "weights")),
    ("velodyne", "calibration"),
)
"""Settings that name files."""


def check_effect(settings: Sequence[str]) -> None:
    """Check that an evaluation reads single settings (`["evaluate.iou=[0.5]"]`); ignores unknown sections."""
    for text in settings:
        key = text.partition("=")[0].strip()
        section = key.partition(".")[0]
        if section in Config.model_fields and section not in EVALUATING:
            raise ConfigError(
                f"settings: {key}: expected a setting of {', '.join(EVALUATING)}, found one that changes nothing in a "
                "result that is there; give it to `lidcam process`"
            )


def named_files(config: Config) -> dict[str, Path]:
    """The existing files that settings name or may choose, by their names in the metadata of a result."""
    model, detect3d = config.detect2d.model, config.detect3d
    model = fetched_network() if model == "auto" else model
    model_3d = detect3d.model if detect3d.method in {"auto", "pillars", "combined"} else None
    named = {"network": model and network_path(model), "network.names": config.detect2d.names}
    named |= {"detect3d.model": model_3d and network_file(model_3d), "detect3d.weights": config.detect3d.weights}
    named["velodyne.calibration"] = config.velodyne.calibration
    # Path.is_file raises where one may not enter; whoever reads the file says so.
    return {key: Path(name) for key, name in named.items() if name and isfile(name)}  # noqa: PTH113


def lasting_settings(config: Config) -> str:
    """All settings that affect a result, as YAML: not those of running, nor folders of files."""
    tree = config.model_dump() | {"run": {}}
    for section, key in NAMED:
        tree[section][key] = tree[section][key] and visible(Path(tree[section][key]).name)
    return dump_config(Config.model_validate(tree))


def settings_sha256(config: Config) -> str:
    """Checksum of all settings that affect a result, the same as in the metadata of an output (`config.sha256`)."""
    return sha256(lasting_settings(config).encode()).hexdigest()
