"""Where a result comes from: said in every output file."""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass

__all__ = ["Provenance"]


@dataclass(frozen=True, slots=True)
class Provenance:
    """Where a result comes from.

    Attributes:
        version: lidcam's.
        inputs: What is known of each input file: `name`, and `sha256` (hexadecimal), or of one on a server `url`
            (without credentials), `size`, and `etag` and `last_modified` where the server says so.
        config_yaml: All settings that have a part in the result: without `run`, so that files stay equal whatever
            the number of workers.
        rig_yaml: The rig, as a rig file.
        start_ns: Log time of the first input message: stands for the wall clock in the attachments.
    """

    version: str
    inputs: tuple[Mapping[str, str], ...]
    config_yaml: str
    rig_yaml: str
    start_ns: int

    def metadata(self) -> dict[str, str]:
        """What the metadata record `lidcam` says."""
        record = {"version": self.version}
        for row, known in enumerate(self.inputs):
            record |= {f"input.{row}.{key}": value for key, value in known.items()}
        for name, text in (("config", self.config_yaml), ("rig", self.rig_yaml)):
            record[f"{name}.sha256"] = hashlib.sha256(text.encode()).hexdigest()
        return record

    @property
    def recording_id(self) -> str:
        """The same for the same inputs, settings and rig: 32 hexadecimal digits."""
        return hashlib.sha256(repr(sorted(self.metadata().items())).encode()).hexdigest()[:32]
