"""Polynomials of u and v with remainders hold the exact matrices, and narrowly."""

import numpy as np
import pytest
from flint import arb, arb_mat, ctx

from flexhinf.certify.checker.taylor_matrix import CONSTANT, TERMS, TaylorMatrix

pytestmark = pytest.mark.oracle

U, V = (1, 0), (0, 1)


def linear(rng, rows, columns, *slopes, scale=1.0):
    """A matrix that is linear in u, in v or in both; entries of the slopes up to 0.01."""
    shape = rows, columns
    parts = {powers: 0.01 * rng.uniform(-1.0, 1.0, shape) for powers in slopes}
    terms = {CONSTANT: np.eye(*shape) + rng.uniform(-scale, scale, shape), **parts}
    return TaylorMatrix({powers: arb_mat(part.tolist()) for powers, part in terms.items()})


def at(matrix, u, v):
    """The enclosure at some u and v."""
    terms = [part * (arb(u) ** k * arb(v) ** l) for (k, l), part in matrix.terms.items()]
    return sum(terms, matrix.remainder)


def places(rng):
    """Corners, edges and some places between."""
    return [(-1.0, 1.0), (1.0, 1.0), (1.0, -1.0), (0.0, -1.0), *rng.uniform(-1.0, 1.0, (6, 2)).tolist()]


#: Which variables are in one matrix, and in the other.
VARIABLES = [((U,), (U,)), ((U, V), (U, V)), ((V,), (U,)), ((), (U, V))]


@pytest.mark.parametrize("variables", VARIABLES)
def test_products_inverses_and_exponentials_are_enclosed_and_narrowly(variables):
    """By plain balls at 400 bits, of which a point needs no polynomial: Arb's own inverse and exponential of a matrix.

    A product of seven factors has powers beyond those that are kept.
    """
    rng = np.random.default_rng(5)
    one, other = linear(rng, 4, 4, *variables[0], scale=0.2), linear(rng, 4, 3, *variables[1])
    with ctx.workprec(400):
        power = one @ one @ one @ one @ one @ one
        found = {
            "product": (power @ other, lambda x, y: x * x * x * x * x * x * y),
            "sum": (one @ other - other.times(arb(3)), lambda x, y: x * y - y * arb(3)),
            "inverse": (one.inverse(), lambda x, y: x.inv()),
            "exponential": (one.times(arb(5)).exponential(), lambda x, y: (x * arb(5)).exp()),
            "parts": (one.rows(1, 3).transpose(), lambda x, y: arb_mat(x.tolist()[1:3]).transpose()),
            "stack": (
                TaylorMatrix.stacked([[one, other]]),
                lambda x, y: arb_mat([a + b for a, b in zip(x.tolist(), y.tolist())]),
            ),
        }
        for u, v in places(rng):
            turned = at(other.along(arb(2), arb(3)).turned(), u, v) - at(other, u, -v) * (2 - 3 * arb(v))
            assert all(e.contains(0) for e in turned.entries())
        both = V in variables[0] + variables[1]
        for name, (enclosed, exactly) in found.items():
            for u, v in places(rng):
                exact = exactly(at(one, u, v), at(other, u, v))
                assert all(e.overlaps(x) for e, x in zip(at(enclosed, u, v).entries(), exact.entries())), name
                # Wider than the exact one by far: so this is a check of the remainder, not of roundings.
                assert max(float(x.rad()) for x in exact.entries()) < 1e-90
                assert all(e.contains(x) for e, x in zip(enclosed.range.entries(), exact.entries())), name
            size = max(float(e.abs_upper()) for e in enclosed.constant.entries())
            wide = max(float(e.rad()) for e in enclosed.remainder.entries())
            assert wide < 2e3 * 0.04 ** TERMS[both] * size, name
            assert sum(max(enclosed.terms)) < TERMS[0]


def test_a_remainder_is_no_wider_than_what_is_left_out():
    """(1 + v)⁷ less its terms of degree 6 and less is v⁷, and (1 + u)⁹ has 9u⁸ + u⁹ beyond the seventh power."""
    for variable, power, left in ((V, 7, 1.0), (U, 9, 10.0)):
        factor = TaylorMatrix({CONSTANT: arb_mat([[1]]), variable: arb_mat([[1]])})
        found = factor
        for _ in range(power - 1):
            found = found @ factor
        (entry,) = found.remainder.entries()
        assert float(entry.abs_upper()) == pytest.approx(left, rel=1e-6)
        assert at(found, 1.0, 1.0)[0, 0].contains(2**power)


def test_an_inverse_that_may_not_exist_is_refused():
    """1 + 0.6 u + 0.6 v is 0 at a corner, though neither 1 + 0.6 u nor 1 + 0.6 v is anywhere."""
    one = {CONSTANT: arb_mat([[1]]), U: arb_mat([[0.6]]), V: arb_mat([[0.6]])}
    with pytest.raises(ZeroDivisionError):
        TaylorMatrix(one).inverse()


@pytest.mark.parametrize("size", [0.3, 3.0, 40.0])
def test_the_exponential_of_a_matrix_is_enclosed_and_narrowly(size):
    """exp of a turn by an angle, at 1,000 bits, where roundings hide nothing of the series that is left out."""
    with ctx.workprec(1000):
        angle = arb(size)
        found = TaylorMatrix.of([[0, -angle], [angle, 0]]).exponential().range
        for entry, exact in zip(found.entries(), (angle.cos(), -angle.sin(), angle.sin(), angle.cos())):
            assert entry.contains(exact)
            assert entry.rad() < 1e-20


def test_what_is_large_beside_what_turns_takes_no_squares():
    """What nothing drives, and what drives nothing, is scaled alone: a large entry there costs no bits of others."""
    rng = np.random.default_rng(6)
    middle = np.zeros((6, 6))
    middle[1:5, 1:5] = rng.uniform(-0.3, 0.3, (4, 4))
    middle[1:5, 5], middle[0, 1:5], middle[0, 5] = 3e3, 7e4, 5e5  # 5 drives all, and all drive 0
    with ctx.workprec(106):
        found = TaylorMatrix.of(middle.tolist()).exponential().range
        exact = arb_mat(middle.tolist())
    with ctx.workprec(400):
        assert all(e.contains(x) for e, x in zip(found.entries(), exact.exp().entries()))
    turned = arb_mat([row[1:5] for row in found.tolist()[1:5]])
    assert max(float(e.rad()) for e in turned.entries()) < 1e-29
