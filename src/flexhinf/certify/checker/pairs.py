"""Check in ball arithmetic that all pairs of a range of λ tolerate the errors of masses and springs that a file states.

The file has the law of the pairs, the loop, two sectors, multipliers, and intervals of λ with P at some λ of each.
P(λ) is the polynomial through these. `flexhinf.modal.popov` has the inequality N(λ) > 0, docs/theorem.md its proof. In
an interval its blocks are polynomials of −1 ≤ u ≤ 1 with remainders (`TaylorMatrix`), and so is the Schur complement of
the last one, which is shown to be positive (`congruence`). With an unknown delay θ an interval is divided into boxes,
in which P is a polynomial of λ and θ.

Nothing is imported from the search. Every number of the file is a double, and read as this rational number.
"""

# Not checked strictly: parts of SciPy and NumPy have no types.
# pyright: reportMissingTypeStubs=false, reportUnknownVariableType=false, reportUnknownArgumentType=false
# pyright: reportUnknownMemberType=false

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable, Sequence
from contextlib import contextmanager
from functools import partial
from itertools import pairwise, product
from typing import NamedTuple

import numpy as np
from flint import arb, arb_mat, ctx, fmpq, fmpq_mat

from flexhinf.certify.checker.at_samples import sampled, sampled_with_model
from flexhinf.certify.checker.congruence import middles, near_unit, towards_unit
from flexhinf.certify.checker.pair_claim import PairClaim
from flexhinf.certify.checker.pair_flow import free_flow, late_flow, pair_flow
from flexhinf.certify.checker.taylor_matrix import (
    NO_ENCLOSURE,
    TaylorMatrix,
    positive_definite,
)

#: Bits of the balls.
BITS = 106

#: A period is divided into so many parts, each at most so many times into two, in which Φ₂₂ is regular.
PARTS, HALVINGS = 4, 8

#: Degree of the factors by which P and a Schur complement are compared with the unit matrix.
FACTOR = 3


#: What gives the result of a function for each of some numbers, in their order.
Every = Callable[[Callable[[int], bool], Sequence[int]], Iterable[bool]]


class CheckedPairs(NamedTuple):
    """What holds of the pairs of a file."""

    low: float  # smallest λ, 1/s²
    high: float  # largest λ, 1/s²
    lower: float  # δ₁: inertia matrices up to M/(1 − δ₁)
    upper: float  # δ₂: and down to M/(1 + δ₂)
    softer: float  # ε₁: stiffness down to (1 − ε₁) K
    stiffer: float  # ε₂: and up to (1 + ε₂) K
    falling: float  # γ₁: slopes of gravity down to −γ₁ K
    holding_up: float  # γ₂: and up to γ₂ K
    spring_damping: float  # β, s: springs damped by up to β K, or not at all
    any_motion: bool  # of one joint: motions of any size, with any torque of gravity that has such slopes
    rate: float  # α, 1/s: small motions about norms decay at least like exp(−αt)
    delay: float  # θ₁, samples: with every constant delay of the inputs up to it, beside the latency
    slower: float  # ν₁: K/J of joints down to (1 − ν₁) κ
    faster: float  # ν₂: and up to (1 + ν₂) κ
    less_friction: float  # φ₁, 1/s: B/J of joints down to β − φ₁
    more_friction: float  # φ₂, 1/s: and up to β + φ₂
    intervals: int

    @property
    def motors(self) -> tuple[float, float, float, float]:
        """ν₁, ν₂, φ₁ and φ₂."""
        return self.slower, self.faster, self.less_friction, self.more_friction


def check_pairs(claim: PairClaim, every: Every = map) -> CheckedPairs | int:
    """What is proved, or the number of the first interval in which the check fails; `every` may do several at once."""
    if not regular_at_first(claim):
        return 0
    places = range(len(claim.storages))
    for k, proved in zip(places, every(partial(interval_proved, claim), places), strict=True):
        if not proved:
            return k
    low, high = claim.links[[0, -1]].tolist()
    errors = claim.lower, claim.upper, claim.softer, claim.stiffer, claim.falling, claim.holding_up
    gravity = claim.spring_damping, claim.any_motion
    motors = (0.0, 0.0, 0.0, 0.0) if claim.motors is None else claim.motors.sizes
    return CheckedPairs(low, high, *errors, *gravity, claim.rate, claim.delay, *motors, len(claim.storages))


class Box(NamedTuple):
    """An interval of λ, in 1/s², and one of θ, in samples, or one θ; P at equidistant ones of both, with their ends."""

    links: tuple[float, float]
    delays: tuple[float, float]
    storages: np.ndarray  # (k, m, n, n), at k values of θ, and at m of λ


def interval_proved(claim: PairClaim, k: int) -> bool:
    """Whether P > 0 and N > 0 for all λ of an interval, and all θ."""
    (low, high), delays, storages = claim.links[k : k + 2].tolist(), claim.delays[k], claim.storages[k]
    if not claim.delay:
        return box_proved(claim, Box((low, high), (0.0, 0.0), storages))
    boxes = zip(pairwise(delays), np.split(storages, len(delays) - 1))
    return all(box_proved(claim, Box((low, high), ends, own)) for ends, own in boxes)


def box_proved(claim: PairClaim, box: Box) -> bool:
    """Whether P > 0 and N > 0 for all λ and θ of a box."""
    with _balls():
        try:
            return _proves(claim, box)
        except NO_ENCLOSURE:
            return False


@contextmanager
def _balls() -> Generator[None]:
    before = ctx.prec
    try:
        ctx.prec = BITS
        yield
    finally:
        ctx.prec = before


def _proves(claim: PairClaim, box: Box) -> bool:
    """P > 0, and N > 0 by P − PWP > 0 and by N's Schur complement T = P − Q − AᵀP (1 − WP)⁻¹ A > 0.

    P − PWP is positive in the middle of the box, and regular everywhere, as 1 − WP is.
    """
    (low, high), (begin, end) = map(arb, box.links), map(arb, box.delays)
    p = _polynomial(box.storages)
    root = arb_mat(np.linalg.cholesky(middles(p.constant)).T.tolist())
    turn, back = TaylorMatrix.of(root.tolist()), TaylorMatrix.of(root.inv().tolist())
    worst = _loop(claim, (low + high) / 2, (high - low) / 2, ((begin + end) / 2, (end - begin) / 2))
    # In the coordinates root · ξ.
    p, w = back.transpose() @ p @ back, turn @ worst.w @ turn.transpose()
    even = towards_unit(p, FACTOR, by_size=False)
    if even is None or not near_unit(even.transpose() @ p @ even):
        return False
    middle, reached = p.constant + p.remainder, w.constant + w.remainder
    if not positive_definite(middle - middle * reached * middle):
        return False
    unit, a = TaylorMatrix.of(np.eye(claim.states, dtype=int).tolist()), turn @ worst.a @ back
    grown = p @ (unit - w @ p).inverse()
    complement = p - back.transpose() @ worst.q @ back - a.transpose() @ grown @ a
    complement = even.transpose() @ complement @ even
    other = towards_unit(complement, FACTOR, by_size=True)
    return other is not None and near_unit(other.transpose() @ complement @ other)


def _polynomial(values: np.ndarray) -> TaylorMatrix:
    """The polynomial of u and v through matrices at equidistant v and u, (k, m, n, n)."""
    rows, columns = (_weights(count) for count in values.shape[:2])
    parts = [[arb_mat(one.tolist()) for one in row] for row in values]
    return TaylorMatrix(
        {
            (i, j): sum(
                (
                    parts[l][k] * (rows[j][l] * columns[i][k])
                    for l, k in product(range(len(rows)), range(len(columns)))
                ),
                parts[0][0] * 0,
            )
            for j, i in product(range(len(rows)), range(len(columns)))
        }
    )


def _weights(count: int) -> list[list[arb]]:
    """Row k: by which the coefficient of uᵏ is a sum of values at equidistant u, −1 to 1; of one value this itself."""
    places = [fmpq(2 * k, count - 1) - 1 for k in range(count)] if count > 1 else [fmpq(0)]
    powers = fmpq_mat([[place**k for k in range(count)] for place in places])
    return [[arb(one) for one in row] for row in powers.inv().tolist()]


class _WorstPeriod(NamedTuple):
    """A, Q and W of a pair, (n, n) each."""

    a: TaylorMatrix
    q: TaylorMatrix
    w: TaylorMatrix


def _loop(claim: PairClaim, centre: arb, half: arb, late: tuple[arb, arb] = (arb(0), arb(0))) -> _WorstPeriod:
    """The worst period of a pair, by the formulas of `flexhinf.modal.popov`, in periods; λ = centre + half·u, and θ the
    same of v and the two numbers `late`."""
    one, alpha = pair_flow(claim, centre, half), arb(claim.rate) * arb(claim.period)
    shift, n, added = one.shift, claim.states, claim.added
    if claim.delay:
        before = pair_flow(claim, centre, half, "force before")
        flow = late_flow(before.hamiltonian, one.hamiltonian, *late)
    else:
        flow = one.hamiltonian.exponential()
    size = shift.constant.nrows()
    x, y = flow.rows(0, size).columns(0, size), flow.rows(0, size).columns(size, 2 * size)
    c, d = flow.rows(size, 2 * size).columns(0, size), flow.rows(size, 2 * size).columns(size, 2 * size)
    end = shift @ y + d
    inverse = end.inverse()
    worst = _WorstPeriod(inverse.transpose(), inverse @ (end @ shift - shift @ x - c), y @ inverse)
    if claim.model_moves:
        acting, chosen, memory = sampled_with_model(claim, centre, half)
        worst = worst if chosen is None else _with_chosen(worst, chosen)
    else:
        acting, memory = sampled(claim, centre, half, free_flow(claim, centre, half))
    # Rows of the flow's states that the worst moves, and where the loop has these.
    places, first = np.zeros((size, n), dtype=int), 4
    places[range(4), range(4)] = places[range(size - added, size), range(n - added, n)] = 1
    if claim.model_moves and claim.with_prediction:
        places[range(size - added - 4, size - added), range(4, 8)], first = 1, 8
    moves = TaylorMatrix.of(places.tolist())
    kept = TaylorMatrix.of(np.eye(n, dtype=int)[first : n - added].T.tolist())
    after = moves.transpose() @ worst.a @ acting + kept @ memory.times(alpha.exp())
    return _WorstPeriod(after, acting.transpose() @ worst.q @ acting, moves.transpose() @ worst.w @ moves)


def _with_chosen(worst: _WorstPeriod, chosen: TaylorMatrix) -> _WorstPeriod:
    """A worst period that begins at x + g c for any c, whose weight −gᵀQg must be positive: it is so in the middle, and
    regular everywhere."""
    weight = -(chosen.transpose() @ worst.q @ chosen)
    if not positive_definite(weight.constant + weight.remainder):
        raise ZeroDivisionError("what is chosen at a sample may gain without bound")
    inverse, moved, gained = weight.inverse(), worst.a @ chosen, worst.q @ chosen
    answer = inverse @ gained.transpose()
    return _WorstPeriod(
        worst.a + moved @ answer, worst.q + gained @ answer, worst.w + moved @ inverse @ moved.transpose()
    )


def regular_at_first(claim: PairClaim) -> bool:
    """Whether Φ₂₂ is regular at all instants of a period at the first λ: then it is so in all intervals in which it is
    regular at the period's end, as `interval_proved` checks (docs/theorem.md, lemma 3)."""
    with _balls():
        try:
            whole_flow = pair_flow(claim, arb(float(claim.links[0])), arb(0))
        except ZeroDivisionError:  # a weight that is not shown to be positive
            return False
        rate, shift = whole_flow.hamiltonian.constant, whole_flow.shift
        size = shift.constant.nrows()
        parts = [(arb(k) / PARTS, arb(k + 1) / PARTS, HALVINGS) for k in range(PARTS)]
        while parts:
            begin, end, halvings = parts.pop()
            centre, half = (begin + end) / 2, (end - begin) / 2
            try:
                flow = TaylorMatrix({(0, 0): rate * centre, (1, 0): rate * half}).exponential()
                flow = flow.columns(size, 2 * size)
                (shift @ flow.rows(0, size) + flow.rows(size, 2 * size)).inverse()
            except (ZeroDivisionError, OverflowError, ValueError):
                if not halvings:
                    return False
                parts += [(begin, centre, halvings - 1), (centre, end, halvings - 1)]
    return True
