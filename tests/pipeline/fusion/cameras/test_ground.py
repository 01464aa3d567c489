import numpy as np
from pipeline.fusion.cameras.ground import Ground


def test_level_ground_is_at_its_height() -> None:
    ground = Ground.level(-1.5)
    assert -ground.plane[3] / ground.plane[2] == -1.5
    assert not ground.relief_m.any()
    np.testing.assert_array_equal(ground.plane[:2], 0.0)
