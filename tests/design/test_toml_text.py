"""What is written as TOML is read back by the standard library as it was."""

from __future__ import annotations

import tomllib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from flexhinf.design.toml_text import toml_table, toml_value

TEXT = st.text(st.characters(exclude_categories=["Cs"]))
PLAIN = st.one_of(
    st.booleans(), TEXT, st.integers(-(2**63), 2**63 - 1), st.floats(allow_nan=False, allow_infinity=True)
)
VALUE = st.recursive(PLAIN, lambda inner: st.lists(inner, max_size=4), max_leaves=8)
TABLE = st.recursive(
    st.dictionaries(TEXT, VALUE, max_size=4),
    lambda inner: st.dictionaries(TEXT, st.one_of(VALUE, inner, st.lists(inner, min_size=1, max_size=3)), max_size=4),
    max_leaves=8,
)  # fmt: skip


@pytest.mark.oracle
@pytest.mark.property
@given(TABLE)
def test_a_table_comes_back(table: dict[str, object]) -> None:
    assert tomllib.loads(toml_table("found", table)) == {"found": table}


def test_numbers_of_numpy_are_numbers() -> None:
    written = toml_value([np.float64(0.1), np.int64(3), np.array([1e-300, -0.0]), np.bool_(True)])
    assert written == "[0.1, 3, [1e-300, -0.0], true]"


def test_what_toml_has_no_value_for_is_refused() -> None:
    with pytest.raises(TypeError, match="NoneType"):
        toml_table("design", {"pose": None})
