import builders
import pytest

from pipeline.core.errors import MessageError
from readers.messages.diagnostics import decode_diagnostics

MSGTYPE = "diagnostic_msgs/msg/DiagnosticArray"


def test_values_by_status() -> None:
    statuses = [
        {"name": "a", "values": [{"key": "x", "value": "1"}, {"key": "y", "value": "2"}, {"key": "x", "value": "3"}]},
        {"name": "b", "values": []},
    ]
    raw = builders.raw("/diagnostics", MSGTYPE, {"status": statuses}, 5)
    assert decode_diagnostics(raw) == {"a": {"x": "3", "y": "2"}, "b": {}}
    assert decode_diagnostics(builders.raw("/diagnostics", MSGTYPE, {}, 5)) == {}


def test_other_type() -> None:
    with pytest.raises(MessageError, match="/image: expected diagnostic_msgs"):
        decode_diagnostics(builders.raw("/image", "sensor_msgs/msg/Image", {}, 5))
