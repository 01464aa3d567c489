"""The origin of a result, stored in every output file."""

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from lidcam.pipeline.core.text import visible


@dataclass(frozen=True, slots=True)
class Provenance:
    """The inputs, settings and rig of a result.

    Attributes:
        version: Version of lidcam.
        inputs: For each input file its `name` and `size`, or for a file on a server its `url` (without credentials),
            `size`, and `etag` and `last_modified` if the server sends them.
        fingerprint: Gives what differs between inputs (hexadecimal), from their ends alone.
        checksums: Gives the content of the metadata record `lidcam.inputs`, at the end of a run: the SHA-256 of each
            input that was read as a whole, and of each file that the settings name; raises a RecordingError where one
            cannot be read.
        settings: Which settings these are, and why.
        config_yaml: All settings that affect the result; not `run`, so that the number of workers does not, nor where
            the files lie that they name.
        rig_yaml: The rig, as a rig file.
        boxes3d_topics: Topics of the recorded 3D boxes that were used.
        start_ns: Log time of the first input message: used for the attachments in place of the wall clock.
        named: Names of the files that the settings name, and the provider that ran the 2D network.
        summary: Gives, at the end of a run, its summary as JSON.
    """

    version: str
    inputs: tuple[Mapping[str, str], ...]
    fingerprint: Callable[[], str]
    checksums: Callable[[], Mapping[str, str]]
    settings: str
    config_yaml: str
    rig_yaml: str
    start_ns: int
    boxes3d_topics: tuple[str, ...] = ()
    named: Mapping[str, str] = field(default_factory=dict)
    summary: Callable[[], str] = lambda: "{}"

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
