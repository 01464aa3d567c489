"""Numbers in tables."""

import pytest

from lidcam.printing.numbers import number, percent, share, signed


@pytest.mark.parametrize(
    ("value", "plain", "with_sign", "in_percent"),
    [
        (None, "-", "-", "-"),
        (0.0, "0.00", "+0.00", "0 %"),
        (-0.001, "0.00", "+0.00", "0 %"),
        (-0.006, "-0.01", "-0.01", "-1 %"),
        (1.234, "1.23", "+1.23", "123 %"),
    ],
)
def test_zero_has_no_minus_and_what_is_not_defined_is_a_dash(
    value: float | None, plain: str, with_sign: str, in_percent: str
) -> None:
    assert (number(value, 2), share(value), signed(value, 2)) == (plain, plain, with_sign)
    assert percent(value) == in_percent
