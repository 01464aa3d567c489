from hypothesis import given
from hypothesis import strategies as st

from lidcam.readers.natural_order import natural_key


@given(st.lists(st.text(), unique=True))
def test_natural_order_is_total(names: list[str]) -> None:
    backwards = names[::-1]
    assert sorted(names, key=natural_key) == sorted(backwards, key=natural_key)


def test_natural_order_counts() -> None:
    assert sorted(["/cam10", "/cam2", "/cam"], key=natural_key) == ["/cam", "/cam2", "/cam10"]
    assert sorted(["9" * 5000, "8" * 5000, "7"], key=natural_key)[0] == "7"
