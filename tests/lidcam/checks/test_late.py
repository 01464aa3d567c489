import pytest
from frames import RIG

from lidcam.checks.late import late_warnings
from pipeline.stages.sync.policy import DropReason


@pytest.mark.parametrize(
    ("drops", "sensors"),
    [
        ({}, []),
        ({("/lidar2", DropReason.TOO_LATE): 10}, ["lidar2"]),
        ({("/lidar2", DropReason.TOO_LATE): 9}, []),
        ({("/lidar2", DropReason.LEFT_OUT): 90}, []),
        ({("/left/image", DropReason.TOO_LATE): 90, ("/odom", "cannot be decoded"): 3}, ["left"]),
    ],
)
def test_sensors_that_are_mostly_late_are_named(drops: dict[tuple[str, str], int], sensors: list[str]) -> None:
    warnings = late_warnings(drops, {"/lidar2": 100, "/left/image": 100}, RIG)
    assert [warning.subject for warning in warnings] == sensors
    assert all("sync.queue_size" in warning.remedy for warning in warnings)
