import pytest

from lidcam.pipeline.core.ros.vision_numbers import CLASS_NUMBERS, CLASS_OF_NUMBER, COUNT_NUMBERS, count_of


@pytest.mark.parametrize(
    ("label", "counted"),
    [
        ("car", None),
        ("4", None),
        ("-", None),
        ("lidar_pointsman", None),
        ("lidar_points", "lidar_points"),
        ("lidar_points/top", "lidar_points/top"),
        ("image_pixels/front", "image_pixels/front"),
        ("occlusion", "occlusion"),
        ("-1", "lidar_points"),
        ("-1000", "lidar_points/0"),
        ("-1999", "lidar_points/999"),
        ("-2000", "image_pixels/0"),
        ("-999", "-999"),
        ("-4000", "-4000"),
        (f"-{'7' * 5000}", None),
    ],
)
def test_what_hypotheses_count(label: str, counted: str | None) -> None:
    assert count_of(label) == counted


def test_numbers_are_told_apart() -> None:
    assert {CLASS_OF_NUMBER[str(number)] for number in CLASS_NUMBERS.values()} == CLASS_NUMBERS.keys()
    assert [count_of(str(number)) for number in COUNT_NUMBERS.values()] == [*COUNT_NUMBERS]
    assert [count_of(name) for name in CLASS_NUMBERS] == [None] * len(CLASS_NUMBERS)
