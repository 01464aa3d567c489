from lidcam.readers.natural_order import natural_key


def test_natural_order_counts() -> None:
    assert sorted(["/cam10", "/cam2", "/cam"], key=natural_key) == ["/cam", "/cam2", "/cam10"]
    assert sorted(["9" * 5000, "8" * 5000, "7"], key=natural_key)[0] == "7"
