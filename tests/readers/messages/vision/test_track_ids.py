import numpy as np

from pipeline.evaluation.evaluation_frame import UNKNOWN
from readers.messages.vision.track_ids import track_ids


def test_numbers_are_themselves_and_names_have_numbers_of_their_own() -> None:
    names = np.array(["7", "", "car1", "007", "car2", "car1", "999999999999999999", "9999999999999999999", "²", "-3"])
    found = track_ids(names)
    assert found.dtype == np.int64
    assert found[[0, 1, 3, 6]].tolist() == [7, UNKNOWN, 7, 999999999999999999]
    of_names = found[[2, 4, 7, 8, 9]]
    assert (of_names >= 1 << 62).all()
    assert len({*of_names.tolist()}) == 5
    assert found[2] == found[5]
    assert track_ids(names[[2]])[0] == found[2]  # whatever else was met before


def test_no_ids() -> None:
    assert track_ids(np.zeros(0, np.str_)).shape == (0,)
