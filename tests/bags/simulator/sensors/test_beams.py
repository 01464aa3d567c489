import numpy as np
import pytest

from lidcam.bags.simulator.scenario.sensors import LidarScenario
from lidcam.bags.simulator.sensors.beams import Beams, pattern_of


def scenario(model: str = "VLP-16", **settings: object) -> LidarScenario:
    values = {"topic": "/points", "frame_id": "lidar", "position_m": (0, 0, 0), "model": model, **settings}
    return LidarScenario.model_validate(values)


def azimuth_deg(beams: Beams) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    """Clockwise from the front."""
    return np.asarray(np.rad2deg(np.arctan2(-beams.directions[..., 1], beams.directions[..., 0])))


def test_a_linear_lidar_is_evenly_spread() -> None:
    pattern = pattern_of(
        scenario("linear", beams=5, elevation_deg=(-20, 20), columns=360, phase_ms=5.0, start_azimuth_deg=0.0)
    )
    assert np.rad2deg(pattern.elevation_rad).tolist() == pytest.approx([-20, -10, 0, 10, 20])
    beams = pattern.beams(2)
    np.testing.assert_allclose(azimuth_deg(beams)[:180, 3], np.arange(180), atol=1e-9)
    np.testing.assert_allclose(np.rad2deg(np.arcsin(beams.directions[7, :, 2])), [-20, -10, 0, 10, 20], atol=1e-9)
    assert beams.times_ns[:, 0].tolist() == np.rint(205e6 + np.arange(360) * 1e8 / 360).astype(int).tolist()
    assert (pattern.begin_ns(2), pattern.begin_ns(3)) == (205_000_000, 305_000_000)
    assert not beams.azimuth_error_rad.any()


@pytest.mark.parametrize(("model", "stride"), [("VLP-16", 2), ("HDL-32E", 7), ("linear", 3)])
def test_a_stride_goes_on_evenly_over_the_sweeps(model: str, stride: int) -> None:
    every, some = (pattern_of(scenario(model, firing_stride=n, columns=100)) for n in (1, stride))
    all_ns = np.concatenate([every.beams(number).times_ns[:, 0] for number in range(4)])
    some_ns = np.concatenate([some.beams(number).times_ns[:, 0] for number in range(4)])
    assert some_ns.tolist() == all_ns[::stride].tolist()
    beams = some.beams(1)
    assert len(beams.directions) == len(beams.azimuth_error_rad) == len(beams.times_ns)
