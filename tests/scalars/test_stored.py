"""A traced function comes back from its arrays with the same bits."""

from __future__ import annotations

import numpy as np
import pytest

import flexhinf as fh
from flexhinf.scalars import apply, clip, function_arrays, function_from_arrays, trace, where


@pytest.mark.oracle
@pytest.mark.parametrize("name", ["paper", "planar-two-link", "spatial-three-link"])
def test_a_robots_dynamics_are_the_same_bits(name: str) -> None:
    flow = fh.load_robot(name).plant().traced_flow
    again = function_from_arrays(function_arrays(flow))
    rng = np.random.default_rng(0)
    for _ in range(3):
        arguments = [rng.normal(size=flow.size1_in(k)) for k in range(flow.n_in())]
        np.testing.assert_array_equal(apply(flow, *arguments)[0], apply(again, *arguments)[0])


def test_pieces_constants_and_empty_arguments() -> None:
    def function(x, y, z):  # type: ignore[no-untyped-def]
        bent = where(x[0] > 0.1, np.sqrt(np.abs(x[1])), -2.5)
        return np.array([bent, clip(x[1], -1.0, 1.0), np.arctan2(x[0], y[0]), 3.0]), x * y[0]

    traced = trace(function, 2, 1, 0)
    again = function_from_arrays(function_arrays(traced))
    for x in ([0.3, -4.0], [-0.3, 0.5]):
        for one, other in zip(apply(traced, x, [0.7], []), apply(again, x, [0.7], []), strict=True):
            np.testing.assert_array_equal(one, other)


def test_what_is_no_operation_is_refused() -> None:
    arrays = function_arrays(trace(lambda x: x * x, 2))
    arrays["operation"] = np.array(["system"] * len(arrays["operation"]))
    with pytest.raises(ValueError, match="'system'"):
        function_from_arrays(arrays)
