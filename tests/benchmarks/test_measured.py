"""What the scripts that measure are given."""

import pytest
from held_out_worlds import look_at_world, named_settings


@pytest.mark.parametrize(
    ("given", "settings"),
    [
        ("a:", ()),
        ("a:x.y=1", ("x.y=1",)),
        ("a:x=[1,2],lidars.*.z={a: 1,b: 2},y=c=d", ("x=[1,2]", "lidars.*.z={a: 1,b: 2}", "y=c=d")),
    ],
)
def test_settings_of_a_detector(given: str, settings: tuple[str, ...]) -> None:
    assert named_settings(given) == ("a", settings)


def test_each_detector_gets_the_cloud_that_its_settings_combine() -> None:
    clusters = "detect3d.method=cluster"
    found = look_at_world("sandbox", {"no": (clusters, "combine.max_range_m=0.1"), "all": (clusters,)}, 3)
    assert {name: any(len(boxes[name]) for _, boxes in found) for name in ("no", "all")} == {"no": False, "all": True}
