"""The line between recorded bytes and typed data.

Whatever goes wrong while a message is decoded is that message's fault, not lidcam's: its bytes come from a file that
anyone may have written, and rosbags, numpy, OpenCV and Google's protobuf raise errors of a dozen types about them.
Decoders check what they can name in words of their own; all else, from the first byte to the finished record, becomes
a `MessageError` here, with the original as its cause and its traceback in the log at level debug. Behind the line, in
the stages and writers, data are typed and checked, and an unexpected error is a bug that keeps its traceback.

Every public function that takes a `RawMessage` and returns what it holds is a `@decoder`: it raises a `MessageError`
about a message of another type, one that could not be read or ends too soon, one with values that contradict each other
or its definition, and one that holds more than the limits allow. Short memory passes: it says nothing of the message.
"""

import logging
from collections.abc import Callable
from functools import wraps
from typing import Any, TypeVar, cast

from lidcam.pipeline.core.errors import LidcamError, MessageError, is_short_memory
from lidcam.pipeline.core.messages import RawMessage
from lidcam.pipeline.core.text import one_line

Decode = TypeVar("Decode", bound=Callable[..., Any])

logger = logging.getLogger(__name__)


def decoder(decode: Decode) -> Decode:
    """A function, or method, whose first argument is a message, so that it raises nothing but `LidcamError`."""

    @wraps(decode)
    def decoded(*arguments: Any, **options: Any) -> Any:
        try:
            return decode(*arguments, **options)
        except LidcamError:
            raise
        except Exception as err:
            if is_short_memory(err):
                raise
            message = next(argument for argument in arguments if isinstance(argument, RawMessage))
            logger.debug("%s: not foreseen by its decoder", message.topic, exc_info=True)
            reason = one_line(err, max_characters=200)
            raise MessageError(
                f"{message.topic}: {len(message.data)} bytes of a {message.channel.msgtype} whose values cannot be "
                f"used ({type(err).__name__}: {reason})"
            ) from err

    return cast(Decode, decoded)
