"""What a decoder did not foresee is told as its message's fault; errors that have words, and short memory, pass."""

import pytest

from lidcam.pipeline.core.errors import ConfigError, MessageError
from lidcam.pipeline.core.messages import Channel, RawMessage
from lidcam.readers.messages.decoding import decoder

MESSAGE = RawMessage(0, 0, (0, 0), b"abc", Channel("/t", "a/msg/B", "cdr"))


@decoder
def decode(message: RawMessage, error: Exception | None = None) -> str:
    if error is not None:
        raise error
    return message.topic


class Decoders:
    @decoder
    def decode(self, message: RawMessage, *, by: int) -> float:
        return len(message.data) / by


def test_results_pass() -> None:
    assert decode(MESSAGE) == "/t"
    assert decode.__name__ == "decode"
    assert Decoders().decode(MESSAGE, by=3) == 1.0


@pytest.mark.parametrize(
    "error",
    [TypeError("a\nb" + "c" * 9000), KeyError("x"), RecursionError(), AttributeError("no field x"), ValueError()],
)
def test_the_unforeseen_is_one_line_with_its_cause(error: Exception) -> None:
    with pytest.raises(MessageError) as caught:
        decode(MESSAGE, error)
    text = str(caught.value)
    assert text.startswith("/t: 3 bytes of a a/msg/B whose values cannot be used (" + type(error).__name__)
    assert "\n" not in text
    assert len(text) < 400
    assert caught.value.__cause__ is error


def test_of_a_method() -> None:
    with pytest.raises(MessageError, match=r"/t: .*ZeroDivisionError"):
        Decoders().decode(MESSAGE, by=0)


@pytest.mark.parametrize("error", [MessageError("/t: known"), ConfigError("a setting"), MemoryError()])
def test_what_is_known_passes(error: Exception) -> None:
    with pytest.raises(type(error)) as caught:
        decode(MESSAGE, error)
    assert caught.value is error
