"""How many lidars a rig may have."""

from dataclasses import replace

import numpy as np
import pytest

from lidcam.pipeline.core.errors import CalibrationError
from lidcam.pipeline.core.geometry.transform import Transform
from lidcam.pipeline.core.rig import LidarSensor, Rig


def test_no_more_lidars_than_a_byte_counts() -> None:
    lidar = LidarSensor("l", "/l", Transform("site", "l", np.eye(4)))
    lidars = tuple(replace(lidar, name=f"l{i}", topic=f"/l{i}") for i in range(256))
    assert len(Rig("site", lidars[:255], (), ()).lidars) == 255
    with pytest.raises(CalibrationError, match=r"256 lidars, expected at most 255: .*topics\.exclude"):
        Rig("site", lidars, (), ())
