import numpy as np
import pytest

from flexhinf.errors import InvalidInput
from flexhinf.loop.controller.options import Limits, checked_period


@pytest.mark.parametrize(
    ("saturation", "lower", "upper"),
    [
        (None, [-np.inf, -np.inf], [np.inf, np.inf]),
        (3.0, [-3.0, -3.0], [3.0, 3.0]),
        ([3.0, 4.0], [-3.0, -4.0], [3.0, 4.0]),
        ((-1.0, 2.0), [-1.0, -1.0], [2.0, 2.0]),
        (([-1.0, -2.0], 5.0), [-1.0, -2.0], [5.0, 5.0]),
        ((-np.inf, 2.0), [-np.inf, -np.inf], [2.0, 2.0]),
    ],
)
def test_every_form(saturation, lower, upper):
    limits = Limits.of(saturation, 2)
    np.testing.assert_array_equal(limits.lower, lower)
    np.testing.assert_array_equal(limits.upper, upper)


@pytest.mark.parametrize(
    "saturation", [0.0, -1.0, (2.0, 1.0), np.nan, "much", [1.0, 2.0, 3.0], (1.0, "b"), [1.0, 0.0]]
)
def test_no_room_is_refused(saturation):
    with pytest.raises(InvalidInput):
        Limits.of(saturation, 2)


@pytest.mark.parametrize("period", [1e-6, 2e-4, 1e-3, 0.1, 1.0])
def test_periods_of_controllers(period):
    assert checked_period(period) == period


@pytest.mark.parametrize(
    ("period", "match"),
    [
        (5, r"period=0\.005 .* 5 ms"), (1000, r" 0\.001 .* 1000 Hz"), (1e-9, r"period.*proportion[\s\S]* 1e-09 s"),
        (0.0, r"positive[\s\S]* 0\.0"), (-1e-3, r"positive[\s\S]* -0\.001"), ("fast", r"positive[\s\S]*'fast'"),
    ],
)  # fmt: skip
def test_periods_out_of_proportion(period, match):
    with pytest.raises(InvalidInput, match=match):
        checked_period(period)
