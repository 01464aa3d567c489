from itertools import count

from lidcam.pipeline.core.frame import SensorBundle
from lidcam.run.frames import _every
from lidcam.run.tally import DropTable


def test_frames_that_are_left_out_hand_their_drops_on() -> None:
    bundles = [SensorBundle(number, number, number, {}, dropped_before={("/a", "late"): 1}) for number in range(7)]
    found = [*_every(bundles, 3, count(), DropTable("skip"))]
    assert [(one.index, one.stamp_ns) for one in found] == [(0, 0), (1, 3), (2, 6)]
    assert [one.dropped_before for one in found] == [{("/a", "late"): drops} for drops in (1, 3, 3)]
