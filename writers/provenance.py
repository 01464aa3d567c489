"""The origin of a result, stored in every output file."""

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from lidcam.pipeline.core.text import visible


@dataclass(frozen=True, slots=True)
class Provenance:
    """The inputs, settings and rig of a result."""

    version: str  # Version of lidcam
    # For each input file its `name` and `size`, or for a file on a server its `url` (without credentials), `size`, and
    # `etag` and `last_modified` if the server sends them
    inputs: tuple[Mapping[str, str], ...]
    fingerprint: Callable[[], str]  # Gives what differs between inputs (hexadecimal), from their ends alone
    # Gives the content of the metadata record `lidcam.inputs`, at the end of a run: the SHA-256 of each input that was
    # read as a whole, and of each file that the settings name; raises a RecordingError where one cannot be read
    checksums: Callable[[], Mapping[str, str]]
    settings: str  # Which settings these are, and why
    # All settings that affect the result; not `run`, so that the number of workers does not, nor where the files lie
    # that they name
    config_yaml: str
    rig_yaml: str  # The rig, as a rig file
    start_ns: int  # Log time of the first input message: used for the attachments in place of the wall clock
    boxes3d_topics: tuple[str, ...] = ()  # Topics of the recorded 3D boxes that were used
    # Names of the files that the settings name, and the provider that ran the 2D network
    named: Mapping[str, str] = field(default_factory=dict)
    summary: Callable[[], str] = lambda: "{}"  # Gives, at the end of a run, its summary as JSON

    def metadata(self) -> dict[str, str]:
        """The content of the metadata record `lidcam`."""
        record = {"version": self.version, "settings": self.settings}
        for row, known in enumerate(self.inputs):
            record |= {f"input.{row}.{key}": value for key, value in known.items()}
        record |= self.named
        for name, text in (("config", self.config_yaml), ("rig", self.rig_yaml)):
            record[f"{name}.sha256"] = hashlib.sha256(text.encode()).hexdigest()
        record |= {f"boxes3d.{row}.topic": topic for row, topic in enumerate(self.boxes3d_topics)}
        return {key: visible(value) for key, value in record.items()}

    @property
    def recording_id(self) -> str:
        """32 hexadecimal digits, the same for the same inputs, settings and rig, whatever the settings are called."""
        facts = {key: value for key, value in self.metadata().items() if key != "settings"}
        facts["fingerprint"] = self.fingerprint()
        return hashlib.sha256(repr(sorted(facts.items())).encode()).hexdigest()[:32]
