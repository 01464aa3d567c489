"""rosbags is the judge of what an image holds."""

from typing import Any, Literal

import numpy as np
import pytest
from builders import header, raw
from hypothesis import given
from hypothesis import strategies as st

from pipeline.core.messages import RawMessage
from writers.messages.image_parts import split_compressed
from writers.messages.images import COMPRESSED, image_cdr, read_image

ENCODINGS: tuple[Literal["ros1", "cdr"], ...] = ("ros1", "cdr")
ascii_texts = st.text(st.characters(codec="ascii", exclude_characters="\0"), max_size=9)


def recorded(frame_id: str, kind: str, data: bytes, encoding: Literal["ros1", "cdr"]) -> RawMessage:
    fields: dict[str, Any] = {"header": header(7, frame_id), "format": kind, "data": np.frombuffer(data, np.uint8)}
    return raw("/c", COMPRESSED, fields, 7, encoding=encoding)


@given(ascii_texts, ascii_texts, st.binary(max_size=9), st.sampled_from(ENCODINGS))
def test_fields_are_those_that_rosbags_reads(
    frame_id: str, kind: str, data: bytes, encoding: Literal["ros1", "cdr"]
) -> None:
    message = recorded(frame_id, kind, data, encoding)
    found, expected = split_compressed(message), read_image(message)
    assert found is not None
    stamp = expected.header.stamp
    assert found.stamp == (stamp.sec, stamp.nanosec)
    assert (found.frame_id.decode(), found.format.decode()) == (expected.header.frame_id, expected.format)
    assert found.data == expected.data.tobytes()


@given(st.binary(max_size=80), st.sampled_from(ENCODINGS), st.integers(0, 60), st.booleans())
def test_what_it_does_not_refuse_is_what_rosbags_reads(
    noise: bytes, encoding: Literal["ros1", "cdr"], kept: int, ends_there: bool
) -> None:
    whole = recorded("camera", "jpeg", b"12345678", encoding)
    data = bytes(whole.data)[:kept] + noise + (b"" if ends_there else bytes(whole.data)[kept:])
    message = whole._replace(data=data)
    if (found := split_compressed(message)) is not None:
        expected = read_image(message)
        assert found.frame_id.decode() == expected.header.frame_id
        assert found.data == expected.data.tobytes()


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize("length", range(0, 40, 3))
def test_cut_ones_are_left_to_rosbags(encoding: Literal["ros1", "cdr"], length: int) -> None:
    message = recorded("camera", "jpeg", b"12345678", encoding)
    assert split_compressed(message._replace(data=message.data[:length])) is None


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_texts_that_are_not_ascii_are_left_to_rosbags(encoding: Literal["ros1", "cdr"]) -> None:
    message = recorded("kamera_ä", "jpeg", b"1", encoding)
    assert split_compressed(message) is None
    assert b"".join(image_cdr(message, frame_id="cam"))[16:20] == b"cam\0"
