from pathlib import Path

import pytest

from lidcam.pipeline.core.errors import RecordingError
from lidcam.readers.location import Location, RemotePath, location


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("drive.bag", Path("drive.bag")),
        ("/data/drive.bag", Path("/data/drive.bag")),
        ("C:\\drive.bag", Path("C:\\drive.bag")),
        ("https:/host/rec.mcap", Path("https:/host/rec.mcap")),
        ("file:///data/my%20drive.bag", Path("/data/my drive.bag")),
        ("https://host/rec.mcap", RemotePath("https://host/rec.mcap")),
        ("S3://bucket/rec.mcap", RemotePath("s3://bucket/rec.mcap")),
    ],
)
def test_location(text: str, expected: Location) -> None:
    assert location(text) == expected


@pytest.mark.parametrize(
    ("url", "shown", "name"),
    [
        ("https://host/a/rec.mcap", "https://host/a/rec.mcap", "rec.mcap"),
        ("http://[::1]:80/rec.mcap", "http://[::1]:80/rec.mcap", "rec.mcap"),
        ("https://host/", "https://host/", "host"),
        ("https://host/rec.mcap?X-Amz-Signature=s3cret", "https://host/rec.mcap?...", "rec.mcap"),
        ("https://host?s3cret", "https://host?...", "host"),
        ("https://ada:s3cret@host/rec.mcap", "https://host/rec.mcap", "rec.mcap"),
        ("https://ada:s3/cret@host/rec.mcap", "https://...", "..."),
        ("https://ada:s3?cret@host/rec.mcap", "https://...", "..."),
        ("s3://ada:s3cret@bucket/rec.mcap", "s3://bucket/rec.mcap", "rec.mcap"),
    ],
)
def test_secrets_are_not_shown(url: str, shown: str, name: str) -> None:
    path = RemotePath(url)
    assert str(path) == shown
    assert repr(path) == f"RemotePath({shown!r})"
    assert path.name == name


def test_an_empty_name_is_not_the_folder_that_one_is_in() -> None:
    with pytest.raises(RecordingError, match="expected a path or a URL, found an empty name"):
        location("")
