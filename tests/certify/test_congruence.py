"""Positive polynomial matrices are found to be so where coordinates turn, and no others are."""

import numpy as np
import pytest
from flint import arb, arb_mat

from flexhinf.certify.checker.congruence import near_unit, towards_unit
from flexhinf.certify.checker.taylor_matrix import TaylorMatrix

Terms = dict[tuple[int, int], np.ndarray]


def accepted(terms: Terms, by_size: bool, wide: float = 0.0) -> bool:
    """By a factor of degree three; every entry may differ by `wide`."""
    ball = arb_mat([[arb(0, wide)] * 3] * 3)
    matrix = TaylorMatrix({powers: arb_mat(part.tolist()) for powers, part in terms.items()}, ball)
    even = towards_unit(matrix, 3, by_size)
    return even is not None and near_unit(even.transpose() @ matrix @ even)


def squared(factor: Terms) -> Terms:
    """RᵀR."""
    found: Terms = {}
    for (i, j), left in factor.items():
        for (k, l), right in factor.items():
            found[i + k, j + l] = found.get((i + k, j + l), np.zeros((3, 3))) + left.T @ right
    return found


@pytest.mark.parametrize("by_size", [False, True])
def test_large_directions_that_turn_are_followed(by_size: bool) -> None:
    """Values 1 and 10⁻⁶ that turn by 0.02 in u and in v: the small one's part grows to 400 times itself."""
    turn = np.array([[0.0, 0.02, 0.0], [-0.02, 0.0, 0.0], [0.0, 0.0, 0.0]])
    size = np.diag([1.0, 1e-3, 1.0])
    terms = squared({(0, 0): size, (1, 0): size @ turn, (0, 1): size @ turn})
    assert accepted(terms, by_size)
    assert not accepted(terms, by_size, wide=1e-6)


def test_what_is_negative_somewhere_is_not_accepted() -> None:
    """M less a number that takes its least value over all u and v below 0, by a grid."""
    rng, kept = np.random.default_rng(5), 0
    for _ in range(40):
        terms = squared(
            {
                (k, l): (np.eye(3) if k + l == 0 else 0.05 * rng.normal(size=(3, 3)))
                for k in range(3)
                for l in range(3 - k)
            }
        )
        grid = [(u, v) for u in np.linspace(-1.0, 1.0, 9) for v in np.linspace(-1.0, 1.0, 9)]
        least = min(
            np.linalg.eigvalsh(sum(u**k * v**l * part for (k, l), part in terms.items()))[0] for u, v in grid
        )
        kept += accepted(terms, by_size=True)
        less = {**terms, (0, 0): terms[0, 0] - 1.001 * least * np.eye(3)}
        assert not accepted(less, by_size=True)
        assert not accepted(less, by_size=False)
    assert kept > 10
