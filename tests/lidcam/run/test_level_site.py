"""A level frame for a tilted lidar, from clouds of a known floor."""

from functools import partial
from typing import Any

import numpy as np
import pytest
from builders import pointcloud2, raw
from memory_recording import MemoryRecording
from rig_messages import static

from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.messages import RawMessage
from lidcam.pipeline.core.settings.config import Config
from lidcam.readers.rig.discovery import discover_rig
from lidcam.readers.rig.schema import RigFile
from lidcam.run.scene import on_level_site

PERIOD_NS = 100_000_000


def turn(roll_deg: float, pitch_deg: float) -> F64:
    """T_level_lidar of a lidar that is rolled about x, then pitched about y."""
    (cr, cp), (sr, sp) = np.cos(np.radians([roll_deg, pitch_deg])), np.sin(np.radians([roll_deg, pitch_deg]))
    pitched = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    return np.asarray(pitched @ [[1, 0, 0], [0, cr, -sr], [0, sr, cr]], np.float64)


def cloud(number: int, T_level_lidar: F64, *, floor: bool = True) -> RawMessage:
    """A floor 1.7 m below the lidar, and a wall ahead; without floor the wall alone."""
    rng = np.random.default_rng(number)
    ground = rng.uniform((-30, -30, -1.7), (30, 30, -1.7), (4000 * floor, 3))
    wall = rng.uniform((15, -20, -1.7), (15.2, 20, 6), (1500, 3))
    xyz = np.concatenate([ground, wall]) @ T_level_lidar
    stamp_ns = number * PERIOD_NS
    return raw(
        "/points", "sensor_msgs/msg/PointCloud2", pointcloud2(xyz.astype(np.float32), stamp_ns=stamp_ns), stamp_ns
    )


def level(messages: list[RawMessage], file: dict[str, Any] | None = None, **sections: Any) -> F64 | None:
    """(3, 3) rotation from the lidar to the level frame; None if there is none."""
    recording, config = MemoryRecording(messages), Config.model_validate(sections)
    rig = None if file is None else RigFile.model_validate(file)
    discover = partial(discover_rig, recording, config)
    found = discover(rig)
    told = on_level_site(found, recording, config, rig, discover)
    if told is found:
        return None
    assert told.sources[0].extrinsics == f"{'rig file' if rig else 'ground'}: lidar_level <- lidar"
    assert told.notes[-1].startswith("lidar: the ground is tilted by ")
    (lidar,) = told.rig.lidars
    assert (lidar.T_site_lidar.dst, lidar.T_site_lidar.translation.tolist()) == ("lidar_level", [0, 0, 0])
    return lidar.T_site_lidar.matrix[:3, :3]


@pytest.mark.parametrize("count", [1, 2, 9])
@pytest.mark.parametrize(("roll_deg", "pitch_deg"), [(0, 7), (0, -25), (-12, 3), (10, 20)])
def test_the_ground_is_level_afterwards(count: int, roll_deg: float, pitch_deg: float) -> None:
    T_level_lidar = turn(roll_deg, pitch_deg)
    found = level([cloud(number, T_level_lidar) for number in range(count)])
    assert found is not None
    up_lidar = T_level_lidar.T @ [0, 0, 1]
    np.testing.assert_allclose(found @ up_lidar, [0, 0, 1], atol=np.radians(0.3))
    assert np.degrees(np.arccos((np.trace(found) - 1) / 2)) == pytest.approx(
        np.degrees(np.arccos(up_lidar[2])), abs=0.3
    ), "turned no further"


@pytest.mark.parametrize(("roll_deg", "pitch_deg"), [(180, 0), (170, 5), (0, 180)])
def test_a_lidar_that_hangs_upside_down(roll_deg: float, pitch_deg: float) -> None:
    T_level_lidar = turn(roll_deg, pitch_deg)
    found = level([cloud(number, T_level_lidar) for number in range(3)])
    assert found is not None
    np.testing.assert_allclose(found @ T_level_lidar.T @ [0, 0, 1], [0, 0, 1], atol=np.radians(0.3))
    assert found[0, 0] > 0.9, "ahead stays ahead"


TILTED = turn(0, 15)


@pytest.mark.parametrize(
    ("messages", "options"),
    [
        pytest.param([cloud(0, turn(3, 3))], {}, id="a road of some degrees"),
        pytest.param([cloud(0, TILTED, floor=False)], {}, id="no floor"),
        pytest.param([cloud(0, turn(0, 60))], {}, id="a wall would be a floor"),
        pytest.param([cloud(0, turn(180, 0), floor=False)], {}, id="upside down without a floor"),
        pytest.param([cloud(row, turn(0, 15 + 3 * row)) for row in range(6)], {}, id="carried by hand"),
        pytest.param([cloud(0, TILTED)], {"file": {"site_frame": "lidar"}}, id="named by the rig file"),
        pytest.param([cloud(0, TILTED)], {"rig": {"site_frame": "lidar"}}, id="named by the settings"),
        pytest.param([cloud(0, TILTED)], {"file": {"ground_height_m": -1.7}}, id="with the height of the ground"),
        pytest.param([static(("base_link", "lidar", (0, 0, 1.7))), cloud(0, TILTED)], {}, id="in a frame of tf"),
        pytest.param([static(("lidar", "lidar_level", (0, 0, 0))), cloud(0, TILTED)], {}, id="there is one"),
    ],
)
def test_the_site_frame_stays(messages: list[RawMessage], options: dict[str, Any]) -> None:
    assert level(messages, **options) is None
