"""Proof in ball arithmetic that every pair of a range of λ is stable, without errors of the model.

With the controller's memory, the latency and the filter (`flexhinf.modal.tolerance.sampled_pair`) the loop of a pair is
ξ⁺ = A ξ, and V = ξᵀ P ξ falls if

    L(λ) = [ P   Aᵀ ; A   P⁻¹ ] > 0.

P is constant in an interval of λ: it is computed in the middle. L differs from the line between its values at the ends
by at most a quarter of (length)² times its second Taylor coefficient, which balls enclose. `flexhinf.modal.popov` has
the errors that a loop tolerates.

The proof is of small motions of an arm at rest, at any pose whose λ are in the range, with motors alike (J = K/κ,
B = βJ), springs without damping, no dry friction, and gravity without slope. The filter's model is the pair's exact
one over a period.
"""

# Not checked strictly: parts of SciPy, CasADi and NumPy have no types.
# pyright: reportUnknownArgumentType=false, reportUnknownVariableType=false, reportMissingTypeStubs=false
# pyright: reportUnknownMemberType=false

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from functools import lru_cache, reduce
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from flint import arb, arb_mat, arb_series, ctx

from flexhinf.arrays import Elements
from flexhinf.modal.pair import PairGains
from flexhinf.modal.tolerance import sampled_pair

if TYPE_CHECKING:
    from flexhinf.estimation.modal import ModalFilter

#: Largest and smallest length of an interval in log λ.
LONGEST, SHORTEST = 0.4, 1e-3

#: Shares, tried in turn, of the slowest mode's distance from the unit circle that P leaves as room.
ROOM = (0.5, 0.15, 0.03)

#: Doublings of the iteration for P.
DOUBLINGS = 40

#: Terms of series in λ, in units of the interval's lower end: value, slope and second coefficient.
TERMS = 3

#: Powers of a matrix in its exponential.
POWERS = 48


class ProvedRange(NamedTuple):
    """Pairs with λ from `low` to `high` are proved to be stable; nothing is proved where these are equal."""

    low: float  # 1/s²
    high: float  # 1/s²
    intervals: int  # of the proof


def proved_range(
    gains: PairGains,
    fastest: float = np.inf,
    latency: int = 0,
    filter: ModalFilter | None = None,
) -> ProvedRange:
    """The λ, from the slowest on, for which pairs are proved to be stable; see this module.

    Parameters
    ----------
    gains, fastest, latency, filter
        As for `flexhinf.modal.error_tolerance`.
    """
    low, high = gains.ends[0], min(gains.ends[1], fastest**2)

    @lru_cache(3)
    def at(*links: float) -> np.ndarray:
        ctx.cap = TERMS if len(links) > 1 else 1  # of one λ the value counts alone
        try:
            return _loop(gains, links, latency, filter)
        finally:
            ctx.cap = TERMS  # a smaller one would cut the second coefficient off wherever it is read

    place, length, count, cap = low, LONGEST, 0, ctx.cap
    try:
        ctx.cap = TERMS
        while place < high and length > SHORTEST:
            end, proved = min(high, place * float(np.exp(length))), False
            try:
                ends, between, middle = (at(place), at(end)), at(place, end), at(float(np.sqrt(place * end)))
                bend = (arb(end) / arb(place) - 1) ** 2 / 4
                proved = any(_positive(ends, between, bend, root) for root in _roots(middle))
            except (ZeroDivisionError, np.linalg.LinAlgError):  # an enclosure or P does not exist
                pass
            place, count = (end, count + 1) if proved else (place, count)
            length = min(LONGEST, 1.5 * length) if proved else 0.5 * length
    finally:
        ctx.cap = cap
    return ProvedRange(low, place, count)


def _loop(
    gains: PairGains,
    links: tuple[float, ...],
    latency: int,
    filter: ModalFilter | None,
) -> np.ndarray:
    series, period, one, o = (
        arb_series([reduce(arb.union, map(arb, links)), links[0]]),
        gains.period,
        arb_series([1]),
        arb_series([0]),
    )
    pair = gains.pair(links[0])
    kappa, beta, nu, b = (one * rate for rate in (pair.motor, pair.damping, pair.holding, pair.input))
    slow = [o, o, series, o, o]
    relative = [-nu, -beta, -series - kappa - nu, -beta, b]
    m = _array([[o, one, o, o, o], slow, [o, o, o, one, o], relative, 5 * [o]])
    # Units that balance matrices, powers of two, so that balls stay small.
    units = np.exp2(np.round(np.log2([1.0, 1.0 / period, 1.0, 1.0 / period, 1.0])))
    model = _exponential(period * m, units / units[:, None])
    terms = _array([[pole / (series + pole) for pole in gains.poles.tolist()] + [one]])[0]
    table, observer = np.vectorize(arb, otypes=[object])(gains.coefficients[:5]), None
    table[:2] += table[2:4]
    if filter is not None:
        seen, gain, (low, high) = filter.pair
        angle = ((2 * series.log() - (low + high)) / (high - low)).acos()
        cosines = _array([[(k * angle).cos() for k in range(len(gain))]])[0]
        gain, seen = (cosines @ gain).reshape(4, -1), seen.copy()
        gain[2:] -= gain[:2]
        seen[:, :2] += seen[:, 2:]
        observer = gain, seen
    acting, memory = sampled_pair(model[:4], table @ terms, period, latency, observer)
    return np.vstack([model[:4] @ acting, memory])


def _array(rows: Sequence[Sequence[arb_series]]) -> np.ndarray:
    """An array of series, which NumPy would take for sequences."""
    array = np.empty((len(rows), len(rows[0])), dtype=object)
    for i, j in np.ndindex(array.shape):
        array[i, j] = rows[i][j]
    return array


def _order(matrix: np.ndarray, k: int) -> arb_mat:
    """The k-th Taylor coefficients of a matrix of series and numbers."""
    return arb_mat([[(arb_series([0]) + entry)[k] for entry in row] for row in matrix])


def _exponential(matrix: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """exp of a square matrix of series, scaled by s_j/s_i; a series is a triangular matrix of its coefficients. By its
    power series, so that a ball is as large as its own entry needs."""
    size, n, parts = range(ctx.cap), len(matrix), [_order(matrix * scale, k).tolist() for k in range(ctx.cap)]
    power = arb_mat(
        [
            [parts[j - i][row][column] if j >= i else 0 for j in size for column in range(n)]
            for i in size
            for row in range(n)
        ]
    )
    unit = arb_mat(np.eye(n, n * ctx.cap).tolist())  # the first rows hold all coefficients
    norm = _size(power.entries())
    remainder = float((norm**POWERS * norm.exp() / arb(POWERS).gamma()).abs_upper())
    values = unit
    for k in range(POWERS - 1, 0, -1):
        values = unit + values * power / k
    table = values.tolist()
    return (
        _array(
            [
                [arb_series([table[i][k * n + j] + arb(0, remainder) for k in size]) for j in range(n)]
                for i in range(n)
            ]
        )
        / scale
    )


def _size(entries: Iterable[arb]) -> arb:
    """An upper bound of the Frobenius norm."""
    return sum((entry.abs_upper() ** 2 for entry in entries), arb(0)).sqrt()


def _numbers(matrix: arb_mat) -> np.ndarray:
    return np.array([[float(entry.mid()) for entry in row] for row in matrix.tolist()])


def _roots(loop: np.ndarray) -> Iterator[arb_mat]:
    """T (n, n), P = TᵀT, with some room."""
    a = _numbers(_order(loop, 0))
    radius = float(np.abs(np.linalg.eigvals(a)).max())
    for room in ROOM if radius < 1.0 else ():
        step, p = a / (1.0 - room * (1.0 - radius)), np.eye(len(a))
        for _ in range(DOUBLINGS):
            step, p = step @ step, p + step.T @ p @ step
        yield arb_mat(np.linalg.cholesky(0.5 * (p + p.T)).T.tolist())


def _positive(ends: tuple[np.ndarray, np.ndarray], between: np.ndarray, bend: arb, root: arb_mat) -> bool:
    """Whether L > 0 in an interval, in the coordinates T ξ; `bend` is a quarter of its length squared."""
    inverse = root.inv()

    def inequality(loop: np.ndarray, order: int) -> np.ndarray:
        a = np.array((root * _order(loop, order) * inverse).tolist())
        unit = np.vectorize(arb, otypes=[object])(np.eye(len(a)) * (order == 0))
        return np.block([[unit, a.T], [a, unit]])

    curved = inequality(between, 2)
    size = bend * _size(curved.ravel())
    remainder: Elements = np.eye(len(curved)) * size  # pyright: ignore[reportOperatorIssue]  # an array of balls
    return all(_definite(inequality(loop, 0) - remainder) for loop in ends)


def _definite(matrix: np.ndarray) -> bool:
    """Whether a symmetric matrix of balls is positive definite: X' M X is, by Gershgorin's circles, with any X."""
    balls = arb_mat(matrix.tolist())
    x = arb_mat(np.linalg.eigh(_numbers(balls))[1].tolist())
    turned = (x.transpose() * balls * x).tolist()
    return all(
        row[i] > sum((abs(e) for j, e in enumerate(row) if j != i), arb(0)) for i, row in enumerate(turned)
    )
