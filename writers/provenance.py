"""The origin of a result, stored in every output file."""

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

__all__ = ["Provenance"]


@dataclass(frozen=True, slots=True)
class Provenance:
    """The inputs, settings and rig of a result.

    Attributes:
        version: Version of lidcam.
        inputs: For each input file its `name` and `size`, or for a file on a server its `url` (without credentials),
            `size`, and `etag` and `last_modified` if the server sends them.
        fingerprint: Gives what differs between inputs (hexadecimal), from their ends alone.
        checksums: Gives the SHA-256 of each input file (hexadecimal) at the end of a run, when all of it was read; None
            of a file that is not read as a whole.
        settings: Which settings these are, and why.
        config_yaml: All settings that affect the result; not `run`, so that the number of workers does not.
        rig_yaml: The rig, as a rig file.
        boxes3d_topics: Topics of the recorded 3D boxes that were used.
        start_ns: Log time of the first input message: used for the attachments in place of the wall clock.
        network: `name` and `sha256` of the 2D network's file, and the `provider` that ran it; empty without one.
    """

    version: str
    inputs: tuple[Mapping[str, str], ...]
    fingerprint: Callable[[], str]
    checksums: Callable[[], tuple[str | None, ...]]
    settings: str
    config_yaml: str
    rig_yaml: str
    start_ns: int
    boxes3d_topics: tuple[str, ...] = ()
    network: Mapping[str, str] = field(default_factory=dict)

    def metadata(self) -> dict[str, str]:
        """The content of the metadata record `lidcam`."""
        record = {"version": self.version, "settings": self.settings}
        for row, known in enumerate(self.inputs):
            record |= {f"input.{row}.{key}": value for key, value in known.items()}
        record |= {f"network.{key}": value for key, value in self.network.items()}
        for name, text in (("config", self.config_yaml), ("rig", self.rig_yaml)):
            record[f"{name}.sha256"] = hashlib.sha256(text.encode()).hexdigest()
        return record | {f"boxes3d.{row}.topic": topic for row, topic in enumerate(self.boxes3d_topics)}

    def later_metadata(self) -> dict[str, str]:
        """The content of the metadata record `lidcam.inputs`, at the end of a run: the inputs' checksums.

        Raises:
            RecordingError: an input cannot be read.
        """
        known = enumerate(self.checksums())
        return {f"input.{row}.sha256": checksum for row, checksum in known if checksum is not None}

    @property
    def recording_id(self) -> str:
        """32 hexadecimal digits, the same for the same inputs, settings and rig, whatever the settings are called."""
        facts = {key: value for key, value in self.metadata().items() if key != "settings"}
        facts["fingerprint"] = self.fingerprint()
        return hashlib.sha256(repr(sorted(facts.items())).encode()).hexdigest()[:32]
