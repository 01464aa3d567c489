"""The settings that affect a result, and their checksum."""

from hashlib import sha256

from pipeline.core.settings.compare import CompareConfig
from pipeline.core.settings.config import Config
from pipeline.core.settings.load import dump_config
from pipeline.core.settings.run import RunConfig

__all__ = ["lasting_settings", "settings_sha256"]


def lasting_settings(config: Config) -> str:
    """All settings that affect a result, as YAML: how it is run or compared with another one does not."""
    return dump_config(config.model_copy(update={"run": RunConfig(), "compare": CompareConfig()}))


def settings_sha256(config: Config) -> str:
    """Checksum of all settings that affect a result, the same as in the metadata of an output (`config.sha256`)."""
    return sha256(lasting_settings(config).encode()).hexdigest()
