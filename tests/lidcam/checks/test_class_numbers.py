from collections.abc import Mapping

import pytest

from lidcam.checks.class_numbers import class_number_warnings
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.core.settings.load import load_config


@pytest.mark.parametrize(
    "unused",
    [{}, {"class 'tram' is not configured": 3}, {"score under detect2d.min_score (0.3)": 4}, {"class '-1' is not": 1}],
)
def test_names_are_no_numbers(unused: Mapping[str, int]) -> None:
    assert class_number_warnings(unused, Config()) == ()


def test_numbers_that_no_class_has() -> None:
    unused = {"class '0' is not configured": 5, "class '7' is not configured": 2, "class 'tram' is not configured": 9}
    (warning,) = class_number_warnings(unused, Config())
    assert str(warning) == (
        "recorded 2D boxes: 7 have class numbers that no class has (0, 7); known are 1 car, 2 pedestrian, 3 bicycle, "
        "4 truck, 5 truck, 6 bus; if their detector numbers as COCO does (0 person, 2 car), "
        "--set detect2d.class_numbers=coco; else add its numbers to the labels of the classes"
    )


def test_long_lists_are_cut_and_there_may_be_no_numbers_among_the_labels() -> None:
    unused = {f"class '{n}' is not configured": 1 for n in range(20, 40)}
    config = load_config(None, {"classes": [{"name": "car", "size_m": [1, 1, 1], "max_size_m": [1, 1, 1]}]})
    (warning,) = class_number_warnings(unused, config)
    assert warning.finding.endswith("(20, 21, 22, 23, 24, 25, 26, 27, 28, 29, ...); known are none")
    assert class_number_warnings(unused, load_config(None, {"detect2d.class_numbers": "coco"})) == ()


def test_numbers_of_3d_boxes() -> None:
    unused = {"class '9' is not configured": 2}
    (warning,) = class_number_warnings({}, Config(), unused)
    assert str(warning).startswith("recorded 3D boxes: 2 have class numbers that no class has (9); known are 1 car, ")
    assert "--set detect3d.recorded.class_numbers=autoware or =coco" in str(warning)
    assert len(class_number_warnings(unused, Config(), unused)) == 2
    for numbers in ("coco", "autoware"):
        config = load_config(None, {"detect3d.recorded.class_numbers": numbers})
        assert class_number_warnings({}, config, unused) == ()
