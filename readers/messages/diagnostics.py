"""Decodes diagnostic_msgs/DiagnosticArray."""

from collections.abc import Mapping

from lidcam.pipeline.core.messages import RawMessage
from lidcam.pipeline.core.settings.recording import DEFAULT_LIMITS, RecordingLimits
from lidcam.readers.messages.decoding import decoder
from lidcam.readers.messages.deserialize import deserialize_as

DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"


@decoder
def decode_diagnostics(
    message: RawMessage, *, limits: RecordingLimits = DEFAULT_LIMITS
) -> Mapping[str, Mapping[str, str]]:
    """The values of each status by its name; of equal names and keys the last."""
    array = deserialize_as(message, DIAGNOSTICS, limits=limits)
    return {status.name: {pair.key: pair.value for pair in status.values} for status in array.status}
