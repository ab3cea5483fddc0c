import math

import pytest

from flexhinf.errors import InvalidInput
from flexhinf.robot import Parameter


def test_the_interval_is_the_tolerance_in_per_cent():
    assert Parameter("k", 100.0, 12.0).interval == pytest.approx((88.0, 112.0))
    assert Parameter("k", -100.0, 12.0).interval == pytest.approx((-112.0, -88.0))
    assert Parameter("k", 5.0).interval == (5.0, 5.0)


def test_points_of_the_interval():
    parameter = Parameter("k", -10.0, 20.0)
    assert [parameter.at(s) for s in (-1.0, 0.0, 0.5, 1.0)] == pytest.approx([-12.0, -10.0, -9.0, -8.0])


def test_the_ends_of_a_range_are_those_that_were_stated():
    for value, ends in ((0.3, (0.05, 12.0)), (0.2, (0.05, 1.5)), (0.05, (1e-3, 2.0)), (12.0, (0.2, 12.0))):
        assert Parameter("m", value, range=ends).interval == ends


@pytest.mark.parametrize(
    ("value", "tolerance"), [(math.nan, 0.0), (math.inf, 0.0), (1.0, -1.0), (1.0, 100.0), (1.0, math.nan)]
)
def test_what_is_no_number_or_percentage_is_refused(value, tolerance):
    with pytest.raises(InvalidInput):
        Parameter("k", value, tolerance)
