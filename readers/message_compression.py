"""Messages that rosbag2 compressed one by one with zstd.

metadata.yaml says whether they are, but it is often lost. A zstd frame is known by its first bytes (RFC 8878, 3.1.1),
and no CDR message begins like one: its first byte is 0 (DDSI-RTPS 10.5).
"""

import zstandard

__all__ = ["decompressed"]

ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"


def decompressed(data: bytes | memoryview, encoding: str, *, announced: bool) -> bytes | memoryview:
    """The message as it was before rosbag2 compressed it, if it did.

    Args:
        data: As recorded.
        encoding: Of the message (`Channel.encoding`).
        announced: Whether metadata.yaml says that messages are compressed.

    Raises:
        zstandard.ZstdError: the frame is damaged, or it was announced and is none.
    """
    if announced or (encoding == "cdr" and data[:4] == ZSTD_MAGIC):
        return zstandard.ZstdDecompressor().decompress(data)
    return data
