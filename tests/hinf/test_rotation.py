"""Pairs of variables mixed by 2×2 blocks: the same as the full change of variables."""

from __future__ import annotations

import numpy as np
import pytest

from flexhinf.hinf.homological import change_variables, rotate_pairs
from flexhinf.polynomial import basis


@pytest.mark.parametrize(
    ("n", "k", "firsts"), [(2, 4, [0]), (5, 3, [1, 3]), (5, 5, [0, 2]), (6, 1, [4]), (4, 3, [])]
)
def test_blocks_act_as_the_whole_matrix(n, k, firsts):
    rng = np.random.default_rng(n + k)
    whole, blocks = np.eye(n, dtype=complex), {}
    for first in firsts:
        block = rng.standard_normal((2, 2)) + 1j * rng.standard_normal((2, 2))
        blocks[first] = whole[first : first + 2, first : first + 2] = block
    entries = rng.standard_normal(basis.count(n, k))
    before = entries.copy()
    assert rotate_pairs(entries, n, k, blocks) == pytest.approx(
        change_variables(entries.astype(complex), n, k, whole), rel=1e-12, abs=1e-12
    )
    assert np.array_equal(entries, before)


def test_unitary_blocks_are_undone_by_their_adjoints():
    pair = np.array([[1, 1], [1j, -1j]]) / np.sqrt(2)
    entries = np.random.default_rng(0).standard_normal(basis.count(5, 4))
    there = rotate_pairs(entries, 5, 4, {0: pair, 2: pair})
    back = rotate_pairs(there, 5, 4, {0: pair.conj().T, 2: pair.conj().T})
    assert back == pytest.approx(entries, abs=1e-13)
