"""JSON that holds only finite numbers."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from hypothesis import given, strategies as st
from tests.refusals import refused_with

from flexhinf import report
from flexhinf.errors import InvalidInput, NumericalFailure

VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
)


@pytest.mark.ci("drawn documents")
@pytest.mark.property
@given(VALUES)
def test_what_is_written_is_read_back(value: object) -> None:
    assert json.loads(report.to_json(value)) == value


def test_numpy_numbers_and_arrays() -> None:
    value = {
        "a": np.float32(0.5),
        "b": np.int64(3),
        "c": np.array([[1.0, 2.0], [3.0, 4.0]]),
        "d": np.bool_(True),
    }
    assert json.loads(report.to_json(value)) == {"a": 0.5, "b": 3, "c": [[1.0, 2.0], [3.0, 4.0]], "d": True}


@pytest.mark.parametrize("number", [math.nan, math.inf, -math.inf, np.float32("nan")])
def test_a_number_that_is_not_finite_is_refused_with_its_place(number: float) -> None:
    with pytest.raises(NumericalFailure, match=r"figures\.03\.estimation_rmse\.1 = "):
        report.to_json({"figures": {"03": {"estimation_rmse": [0.0, number]}}})


def test_what_json_does_not_have_is_refused() -> None:
    with refused_with(InvalidInput, "complex"):
        report.to_json({"a": 1j})
    with refused_with(InvalidInput, "document", 3):
        report.to_json({3: "three"})
