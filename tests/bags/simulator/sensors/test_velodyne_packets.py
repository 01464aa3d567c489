import numpy as np
import pytest
from velodyne import assert_as_judged, judged, scan

from lidcam.bags.simulator.sensors.beams import EncodedPackets, VelodyneSensor
from lidcam.pipeline.core.arrays import F64, U8
from lidcam.pipeline.core.clouds import PointCloud
from lidcam.pipeline.core.settings.recording import VelodyneLidarConfig
from lidcam.readers.velodyne.decoder import VelodyneDecoder
from lidcam.readers.velodyne.models import MODELS

MODES = ("strongest", "last", "dual")
START_NS = 1_000_000_000_000


def sensor(model: str, mode: str = "strongest", **options: float) -> VelodyneSensor:
    return VelodyneSensor(model, START_NS, return_mode=mode, **options)  # type: ignore[arg-type]  # drawn from MODES


def decode(packets: EncodedPackets) -> PointCloud:
    return VelodyneDecoder(VelodyneLidarConfig())(scan(packets.payload, packets.stamps_ns))


def some_ranges(of: VelodyneSensor, packets: int, seed: int = 0) -> tuple[F64, U8]:
    rng = np.random.default_rng(seed)
    shape = (packets * of.firings_per_packet, MODELS[of.model].lasers, *([2] if of.return_mode == "dual" else []))
    ranges_m = rng.uniform(0.5, 120, shape)
    ranges_m[rng.random(shape) < 0.2] = np.inf
    return ranges_m, rng.integers(0, 256, shape).astype(np.uint8)


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("model", ["VLP-16", "Puck Hi-Res", "HDL-32E", "VLP-32C"])
def test_velodyne_decoder_reads_it_as_we_do(model: str, mode: str) -> None:
    source = sensor(model, mode, start_azimuth_deg=359)
    packets = source.encode(7, *some_ranges(source, 12))
    assert_as_judged(decode(packets), judged(model, packets.payload, packets.stamps_ns), model)
