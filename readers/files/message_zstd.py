"""Messages that rosbag2 compressed one by one with zstd.

metadata.yaml says whether they are, but it is often lost. Zstd frames are recognised by their first bytes (RFC 8878,
3.1.1), with which no CDR message can begin: its first byte is 0 (DDSI-RTPS 10.5).
"""

import zstandard

__all__ = ["decompressed"]

ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"


def decompressed(data: bytes | memoryview, encoding: str, *, announced: bool, largest: int) -> bytes | memoryview:
    """The message, decompressed if rosbag2 compressed it.

    Args:
        data: As recorded.
        encoding: Of the message (`Channel.encoding`).
        announced: Whether metadata.yaml says that messages are compressed.
        largest: Bytes that it may unpack to.

    Raises:
        ValueError: it unpacks to more.
        zstandard.ZstdError: the frame is damaged, or the message was announced as compressed and is not.
    """
    if announced or (encoding == "cdr" and data[:4] == ZSTD_MAGIC):
        size = zstandard.frame_content_size(data)  # negative if the frame does not say it
        if size > largest:
            raise ValueError(f"a message unpacks to {size} bytes, see limits.max_message_mib")
        return zstandard.ZstdDecompressor().decompress(data, max_output_size=largest)
    return data
