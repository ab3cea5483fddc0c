"""Proof in ball arithmetic that every pair of a range of λ is stable with all errors of the model up to a size.

Between samples a pair is ẋ = M x + G d, a = C x, with x = (z, z′, w, w′, f), the accelerations a of link and motor, and
errors d that are added to these; the motor's a and d are divided by a scaling s. Errors d = Δ a with ‖Δ‖ ≤ δ have
∫ δ²|a|² − |d|² ≥ 0. They may be nonlinear, change with time, and mix pairs, but not links with motors. Over a period h

    max over d of  V(x(h)) + ∫ δ²|a|² − |d|²   =   max over v of  V(A x + v) + xᵀ Q x − vᵀ W⁻¹ v,

    Φ = exp(h [ M  GGᵀ ; −δ²CᵀC  −Mᵀ ]),   W = Φ₁₂ Φ₂₂⁻¹,   Q = −Φ₂₂⁻¹ Φ₂₁,   A = Φ₁₁ − W Φ₂₁,

if Φ₂₂ is regular up to h [chen1995]; this is exact between the samples too. With the controller's memory, the latency
and the filter (`flexhinf.modal.tolerance.sampled_pair`) the loop is ξ⁺ = A ξ + v with other A and Q, and V = ξᵀ P ξ
falls under all these errors if [boyd1994]

    L(λ) = [ P − Q   Aᵀ ; A   P⁻¹ − W ] > 0,

which for δ = 0 is stability. P is constant in an interval of λ: it is computed in the middle. L differs from the line
between its values at the ends by at most a quarter of (length)² times its second Taylor coefficient, which balls
enclose.

The proof is of small motions of an arm at rest, at any pose whose λ are in the range, with motors alike (J = K/κ,
B = βJ), springs without damping, no dry friction, and gravity without slope. The filter's model is the pair's exact
one over a period.
"""

# Not checked strictly: parts of SciPy, CasADi and NumPy have no types.
# pyright: reportUnknownArgumentType=false, reportUnknownVariableType=false

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

#: Largest and smallest length of an interval in log λ; number of parts of a period in which Φ₂₂ is enclosed.
LONGEST, SHORTEST, PARTS = 0.4, 1e-3, 32

#: Shares, tried in turn, of the slowest mode's distance from the unit circle that P leaves as room; the number added to
#: make P definite; doublings of its iteration.
ROOM, SMALL, DOUBLINGS = (0.5, 0.15, 0.03), 1e-6, 40

#: Terms of series in λ, in units of the interval's lower end: value, slope and second coefficient.
TERMS = 3

#: Powers of a matrix in its exponential.
POWERS = 48


class ProvedRange(NamedTuple):
    """Pairs with λ from `low` to `high` are proved to be stable; nothing is proved where these are equal."""

    low: float  # 1/s²
    high: float  # 1/s²
    error: float  # largest ‖Δ‖, a share of the accelerations
    intervals: int  # of the proof


def proved_range(
    gains: PairGains,
    error: float = 0.0,
    fastest: float = np.inf,
    latency: int = 0,
    filter: ModalFilter | None = None,
    scaling: float = 1.0,
) -> ProvedRange:
    """The λ, from the slowest on, for which pairs are proved to be stable with errors up to `error`; see this module.

    Parameters
    ----------
    gains, fastest, latency, filter
        As for `flexhinf.modal.error_tolerance`.
    error : float
        Largest ‖Δ‖, a share of the accelerations; 0 for stability alone.
    scaling : float
        s, a number; `Tolerance.scaling` suits the error.
    """
    low, high = gains.ends[0], min(gains.ends[1], fastest**2)

    @lru_cache(3)
    def at(*links: float) -> _PairLoop:
        ctx.cap = TERMS if len(links) > 1 else 1  # of one λ the value counts alone
        try:
            return _loop(gains, links, error, latency, filter, scaling)
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
    return ProvedRange(low, place, error, count)


class _PairLoop(NamedTuple):
    """A, Q and W of a pair, (n, n) each, arrays of series in λ."""

    a: np.ndarray
    q: np.ndarray
    w: np.ndarray

    def order(self, k: int) -> list[arb_mat]:
        """The k-th Taylor coefficients."""
        return [_order(part, k) for part in self]


def _loop(
    gains: PairGains,
    links: tuple[float, ...],
    error: float,
    latency: int,
    filter: ModalFilter | None,
    scaling: float,
) -> _PairLoop:
    series, period, one, o = (
        arb_series([reduce(arb.union, map(arb, links)), links[0]]),
        gains.period,
        arb_series([1]),
        arb_series([0]),
    )
    pair = gains.pair(links[0])
    kappa, beta, nu, b = (one * rate for rate in (pair.motor, pair.damping, pair.holding, pair.input))
    slow, fast = [o, o, series, o, o], [-nu, o, -kappa - nu, o, b]
    relative = [-nu, -beta, -series - kappa - nu, -beta, b]
    m = _array([[o, one, o, o, o], slow, [o, o, o, one, o], relative, 5 * [o]])
    # Units that balance matrices, powers of two, so that balls stay small.
    units = np.exp2(np.round(np.log2([1.0, 1.0 / period, 1.0, 1.0 / period, 1.0])))
    model = _exponential(period * m, units / units[:, None])
    moved, q, w = model, np.zeros((5, 5)), np.zeros((5, 5))
    if error > 0.0:
        c, g = _array([slow, [entry / arb(scaling) for entry in fast]]), np.zeros((5, 2), dtype=object)
        g[[1, 3, 3], [0, 0, 1]] = 1, -1, arb(scaling)
        hamiltonian = np.vstack([np.hstack([m, g @ g.T]), np.hstack([c.T @ c * -(arb(error) ** 2), -m.T])])
        weight = (error + 0.01) * max(links[0], pair.input) / period
        units = np.concatenate([units, np.exp2(np.round(np.log2(weight))) / units])
        scale = units / units[:, None]
        for part in range(PARTS):  # an inverse that may not exist is a ZeroDivisionError
            instant = arb(part).union(arb(part + 1)) * period / PARTS
            flow = (_order(hamiltonian * scale, 0) * instant).exp().tolist()
            arb_mat([row[5:] for row in flow[5:]]).inv()
        flow = _exponential(period * hamiltonian, scale)
        inverse = _inverse(flow[5:, 5:])
        w, q = flow[:5, 5:] @ inverse, -inverse @ flow[5:, :5]
        moved = flow[:5, :5] - w @ flow[5:, :5]
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
    a = np.vstack([moved[:4] @ acting, memory])
    whole = np.zeros(a.shape, dtype=object)
    whole[:4, :4] = w[:4, :4]
    return _PairLoop(a, acting.T @ q @ acting, whole)


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
    unit = arb_mat(np.eye(len(matrix) * ctx.cap).tolist())
    norm = _size(power.entries())
    remainder = float((norm**POWERS * norm.exp() / arb(POWERS).gamma()).abs_upper())
    values = unit
    for k in range(POWERS - 1, 0, -1):
        values = unit + power * values / k
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


def _inverse(matrix: np.ndarray) -> np.ndarray:
    """The inverse of a matrix of series by elimination; a pivot that may be zero is a ZeroDivisionError."""
    n = len(matrix)
    rows = np.hstack([matrix, np.eye(n)])
    for i in range(n):
        pivot = rows[i, i]
        if (pivot[0]).contains(0):
            raise ZeroDivisionError
        for j in range(2 * n):
            rows[i, j] = rows[i, j] / pivot
        for k in range(n):
            if k != i:
                factor = rows[k, i]
                for j in range(2 * n):
                    rows[k, j] = rows[k, j] - factor * rows[i, j]
    return rows[:, n:]


def _size(entries: Iterable[arb]) -> arb:
    """An upper bound of the Frobenius norm."""
    return sum((entry.abs_upper() ** 2 for entry in entries), arb(0)).sqrt()


def _numbers(matrix: arb_mat) -> np.ndarray:
    return np.array([[float(entry.mid()) for entry in row] for row in matrix.tolist()])


def _roots(loop: _PairLoop) -> Iterator[arb_mat]:
    """T (n, n), P = TᵀT, with some room."""
    a, q, w = map(_numbers, loop.order(0))
    unit, radius = np.eye(len(a)), float(np.abs(np.linalg.eigvals(a)).max())
    for room in ROOM:
        more = 1.0 + 0.2 * room
        step, p, other = a / (1.0 - room * (1.0 - radius)), more * q + SMALL * unit, -more * w
        for _ in range(DOUBLINGS):
            inverse = np.linalg.inv(unit + other @ p)
            left = step @ inverse
            step, other, p = left @ step, other + left @ other @ step.T, p + step.T @ p @ inverse @ step
        if np.all(np.linalg.eigvalsh(p) > 0.0):
            yield arb_mat(np.linalg.cholesky(0.5 * (p + p.T)).T.tolist())


def _positive(ends: tuple[_PairLoop, _PairLoop], between: _PairLoop, bend: arb, root: arb_mat) -> bool:
    """Whether L > 0 in an interval, in the coordinates T ξ; `bend` is a quarter of its length squared."""
    inverse = root.inv()

    def inequality(loop: _PairLoop, order: int) -> np.ndarray:
        a, q, w = loop.order(order)
        turned = root * a * inverse, inverse.transpose() * q * inverse, root * w * root.transpose()
        a, q, w = (np.array(part.tolist()) for part in turned)
        unit = np.eye(len(a)) * (order == 0)
        return np.block([[unit - q, a.T], [a, unit - w]])

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
