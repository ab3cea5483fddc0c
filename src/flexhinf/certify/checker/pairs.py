"""Check in ball arithmetic that all pairs of a range of λ tolerate the errors of mass that a file states.

The file has the law of the pairs, the loop, a sector, a multiplier τ, and intervals of λ with P at both ends. P(λ) is
linear between these. `flexhinf.modal.popov` has the inequality N(λ) > 0, docs/theorem.md its proof. In an interval N is
a polynomial N₀ + N₁ u + … of −1 ≤ u ≤ 1 with a remainder (`TaylorMatrix`): so N₀ ± N₁ > 0 is checked, less the norms
of all that follows.

Nothing is imported from the search. Every number of the file is a double, and read as this rational number.
"""

# Not checked strictly: parts of SciPy and NumPy have no types.
# pyright: reportMissingTypeStubs=false, reportUnknownVariableType=false, reportUnknownArgumentType=false
# pyright: reportUnknownMemberType=false

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np
from flint import arb, arb_mat, arb_series, ctx

from flexhinf.certify.checker.taylor_matrix import TaylorMatrix, frobenius, positive_definite, taylor_row
from flexhinf.errors import InvalidInput, refuse_if

#: Bits of the balls.
BITS = 106

#: A period is divided into so many parts, each at most so many times into two, in which Φ₂₂ is regular.
PARTS, HALVINGS = 4, 8

#: Coordinates of (z, z′, s, s′, f): what an error pushes, the twist s, and its rate.
PUSH, TWIST, TURN = (0.0, 1.0, 0.0, -1.0, 0.0), (0.0, 0.0, 1.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0, 0.0)

#: Keys of single numbers in a file.
SCALARS = ["period", "motor", "damping", "holding", "input", "lower", "upper", "multiplier", "rate"]

#: Most intervals, states of a pair, and terms of a filter's series in a file.
MOST = 100_000, 40, 2_000


class PairClaim(NamedTuple):
    """The numbers of a file, all finite; units in `flexhinf.modal.pair`."""

    period: float  # s
    motor: float  # κ, 1/s²
    damping: float  # β, 1/s
    holding: float  # ν, 1/s²
    input: float  # b, 1/s²
    latency: int  # samples
    poles: np.ndarray  # (k,), 1/s²
    coefficients: np.ndarray  # (5, k + 1), of the gains of z, z′, w, w′ and the integral
    seen: np.ndarray | None  # (m, 4), what the filter measures of z, z′, w, w′; None for the true state
    table: np.ndarray | None  # (d, 4m), Chebyshev coefficients of its gains
    filter_range: tuple[float, float] | None  # ends of log λ in it
    lower: float  # δ₁
    upper: float  # δ₂
    multiplier: float  # τ, periods
    rate: float  # α, 1/s
    links: np.ndarray  # (N + 1,), ends λ of the intervals, ascending, 1/s²
    storages: np.ndarray  # (N, 2, n, n), P at both ends of each

    @property
    def states(self) -> int:
        """n, of the loop of a pair."""
        return 6 + self.latency + 4 * (self.seen is not None)


class CheckedPairs(NamedTuple):
    """What holds of the pairs of a file."""

    low: float  # smallest λ, 1/s²
    high: float  # largest λ, 1/s²
    lower: float  # δ₁: inertia matrices up to M/(1 − δ₁)
    upper: float  # δ₂: and down to M/(1 + δ₂)
    rate: float  # α, 1/s: small motions about rest decay at least like exp(−αt)
    intervals: int


def pair_claim(numbers: Mapping[str, Any]) -> PairClaim:
    """The claim of a parsed file; InvalidInput where it is damaged."""
    try:
        one = {name: _finite(numbers[name], 0) for name in SCALARS}
        latency, observer, parts = numbers["latency"], numbers["observer"], numbers["intervals"]
        if isinstance(latency, bool) or not isinstance(latency, int) or not 0 <= latency <= MOST[1]:
            raise ValueError(f"latency {latency!r}")
        if not isinstance(parts, list) or not 1 <= len(parts) <= MOST[0]:
            raise ValueError("no interval, or too many")
        seen = table = ends = None
        if observer is not None:
            seen, table = _finite(observer["seen"], 2), _finite(observer["table"], 2)
            ends = tuple(_finite(observer["range"], 1).tolist())
            fits = seen.shape[1:] == (4,) and table.shape[1:] == (4 * len(seen),)
            if not (fits and len(ends) == 2 and ends[0] < ends[1] and len(table) <= MOST[2]):
                raise ValueError("the observer has other shapes")
        poles, coefficients = _finite(numbers["poles"], 1), _finite(numbers["coefficients"], 2)
        n = 6 + latency + 4 * (seen is not None)
        links = _finite([parts[0]["low"], *(part["high"] for part in parts)], 1)
        triangles = _finite([part["storages"] for part in parts], 3)
        if any(part["low"] != low for part, low in zip(parts, links.tolist())):
            raise ValueError("an interval does not begin where the one before it ends")
        if coefficients.shape != (5, len(poles) + 1) or triangles.shape[1:] != (2, n * (n + 1) // 2):
            raise ValueError("the law or a storage has other shapes")
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise InvalidInput(
            "The certificate of a workspace cannot be read.",
            f"{type(error).__name__}: {str(error)[:200]}",
            "the file that flexhinf certify has written",
        ) from error
    wrong = [
        name
        for name, right in (
            ("period", one["period"] > 0.0),
            ("motor", one["motor"] >= 0.0),  # 0: a drive rejects its load
            ("damping", one["damping"] >= 0.0),
            ("holding", one["holding"] >= 0.0),
            ("input", one["input"] > 0.0),
            ("rate", one["rate"] >= 0.0),
            ("lower", 0.0 <= one["lower"] < 1.0),
            ("upper", one["upper"] >= 0.0),
            ("poles", (poles > 0.0).all()),
            ("intervals", links[0] > 0.0 and (np.diff(links) > 0.0).all()),
        )
        if not right
    ]
    refuse_if(
        bool(wrong),
        "The certificate of a workspace has numbers outside their ranges.",
        f"expected positive rates, a sector below 1 and ascending intervals, got other {', '.join(wrong)}",
        "the file that flexhinf certify has written",
    )
    storages = np.zeros((len(parts), 2, n, n))
    rows, columns = np.tril_indices(n)
    storages[..., rows, columns] = storages[..., columns, rows] = triangles
    return PairClaim(
        **{name: float(value) for name, value in one.items()},
        latency=latency,
        poles=poles,
        coefficients=coefficients,
        seen=seen,
        table=table,
        filter_range=ends,
        links=links,
        storages=storages,
    )


def _finite(value: object, dimensions: int) -> np.ndarray:
    """Numbers of a file, neither text nor truth values."""

    def plain(part: object) -> None:
        if isinstance(part, list):
            for one in part:
                plain(one)
        elif isinstance(part, bool) or not isinstance(part, (int, float)):
            raise ValueError(f"{part!r} is no number")

    plain(value)
    array = np.asarray(value, dtype=float)
    if array.ndim != dimensions or array.size == 0 or not np.isfinite(array).all():
        raise ValueError(f"expected finite numbers in {dimensions} dimensions")
    return array


def check_pairs(claim: PairClaim) -> CheckedPairs | int:
    """What is proved, or the number of the first interval in which the check fails."""
    if not regular_at_first(claim):
        return 0
    for k in range(len(claim.storages)):
        if not interval_proved(claim, k):
            return k
    low, high = claim.links[[0, -1]].tolist()
    return CheckedPairs(low, high, claim.lower, claim.upper, claim.rate, len(claim.storages))


def interval_proved(claim: PairClaim, k: int) -> bool:
    """Whether P > 0 and N > 0 for all λ of an interval."""
    with _balls():
        try:
            return _proves(claim, k)
        except (
            ZeroDivisionError,
            OverflowError,
            ValueError,
            np.linalg.LinAlgError,
        ):  # an enclosure does not exist
            return False


@contextmanager
def _balls() -> Iterator[None]:
    before = ctx.prec
    try:
        ctx.prec = BITS
        yield
    finally:
        ctx.prec = before


def _proves(claim: PairClaim, k: int) -> bool:
    (low, high), storages = claim.links[k : k + 2].tolist(), claim.storages[k]
    root = arb_mat(np.linalg.cholesky(storages.mean(axis=0)).T.tolist())
    inverse = root.inv()
    first, last = (inverse.transpose() * arb_mat(p.tolist()) * inverse for p in storages)
    if not (positive_definite(first) and positive_definite(last)):
        return False
    p = TaylorMatrix([(first + last) * arb(0.5), (last - first) * arb(0.5), first * 0])
    centre, half = (arb(low) + arb(high)) / 2, (arb(high) - arb(low)) / 2
    value, slope, *others = _inequality(_loop(claim, centre, half), p, root, inverse).parts
    unit = arb_mat(np.eye(value.nrows()).tolist())
    tail = unit * sum((frobenius(part.entries()) for part in others), arb(0))
    return all(positive_definite(value + sign * slope - tail) for sign in (1, -1))


class _WorstPeriod(NamedTuple):
    """A, Q and W of a pair, (n, n) each."""

    a: TaylorMatrix
    q: TaylorMatrix
    w: TaylorMatrix


def _inequality(worst: _WorstPeriod, p: TaylorMatrix, root: arb_mat, inverse: arb_mat) -> TaylorMatrix:
    """N = [ P − Q   AᵀP ; PA   P − PWP ] in the coordinates root · ξ, which are those of p."""
    turn, back = TaylorMatrix.of(root.tolist()), TaylorMatrix.of(inverse.tolist())
    moved = p @ turn @ worst.a @ back
    first = p - back.transpose() @ worst.q @ back
    last = p - p @ (turn @ worst.w @ turn.transpose()) @ p
    return TaylorMatrix.stacked([[first, moved.transpose()], [moved, last]])


def _loop(claim: PairClaim, centre: arb, half: arb) -> _WorstPeriod:
    """The worst period of a pair, by the formulas of `flexhinf.modal.popov`, in periods; λ = centre + half·u."""
    hamiltonian, free = _hamiltonian(claim, centre, half)
    shift = TaylorMatrix.of(_times(np.outer(TURN, TURN), arb(claim.multiplier)))
    flow = hamiltonian.exponential()
    x, y = flow.rows(0, 5).columns(0, 5), flow.rows(0, 5).columns(5, 10)
    c, d = flow.rows(5, 10).columns(0, 5), flow.rows(5, 10).columns(5, 10)
    end = shift @ y + d
    inverse = end.inverse()
    w, q = y @ inverse, inverse @ (end @ shift - shift @ x - c)
    acting, memory = _sampled(claim, centre, half, free.exponential().rows(0, 4))
    own, other = 4, claim.states - 4
    felt, across = w.rows(0, own).columns(0, own), TaylorMatrix.of([[0] * other for _ in range(own)])
    empty = TaylorMatrix.of([[0] * other for _ in range(other)])
    whole = TaylorMatrix.stacked([[felt, across], [across.transpose(), empty]])
    growth = (arb(claim.rate) * arb(claim.period)).exp()
    after = TaylorMatrix.stacked([[inverse.transpose().rows(0, 4) @ acting], [memory.times(growth)]])
    return _WorstPeriod(after, acting.transpose() @ q @ acting, whole)


def _hamiltonian(claim: PairClaim, centre: arb, half: arb) -> tuple[TaylorMatrix, TaylorMatrix]:
    """The Hamiltonian matrix (10, 10) without τs′², and M (5, 5)."""
    h = arb(claim.period)
    alpha, tau, lower, upper = map(arb, (claim.rate, claim.multiplier, claim.lower, claim.upper))
    alpha *= h
    kappa, beta, nu, b = claim.motor * h**2, claim.damping * h, claim.holding * h**2, claim.input * h**2
    still = arb_mat(
        [
            [0, 1, 0, 0, 0],
            [0, 0, 0, 0, 0],
            [0, 0, 0, 1, 0],
            [-nu, -beta, -kappa - nu, -beta, b],
            [0, 0, 0, 0, 0],
        ]
    )
    size = [h**2 * centre, h**2 * half, arb(0)]

    def by_size(left: Sequence[float], right: Sequence[float], factor: arb) -> TaylorMatrix:
        """λh² times a factor and an outer product."""
        table = arb_mat(_times(np.outer(left, right), factor))
        return TaylorMatrix([table * part for part in size])

    free = TaylorMatrix([still, still * 0]) + by_size(PUSH, TWIST, arb(1))
    m = free + TaylorMatrix.of(_times(np.eye(5), alpha))
    n = (upper - lower) / 2 + tau * alpha
    shift = TaylorMatrix.of(_times(np.outer(TURN, TURN), tau))
    moved = m + by_size(PUSH, TWIST, n)
    gained = by_size(TWIST, TWIST, n**2 + lower * upper) + shift @ m + m.transpose() @ shift
    push = by_size(PUSH, PUSH, arb(1))
    return TaylorMatrix.stacked([[moved, push], [-gained, -moved.transpose()]]), free


def regular_at_first(claim: PairClaim) -> bool:
    """Whether Φ₂₂ is regular at all instants of a period at the first λ: then it is so in all intervals in which it is
    regular at the period's end, as `interval_proved` checks (docs/theorem.md, lemma 3)."""
    with _balls():
        rate = _hamiltonian(claim, arb(float(claim.links[0])), arb(0))[0].parts[0]
        added = _times(np.outer(TURN, TURN), arb(claim.multiplier))
        parts = [(arb(k) / PARTS, arb(k + 1) / PARTS, HALVINGS) for k in range(PARTS)]
        while parts:
            begin, end, halvings = parts.pop()
            centre, half = (begin + end) / 2, (end - begin) / 2
            try:
                flow = TaylorMatrix([rate * centre, rate * half, rate * 0]).exponential().columns(5, 10)
                (TaylorMatrix.of(added) @ flow.rows(0, 5) + flow.rows(5, 10)).inverse()
            except (ZeroDivisionError, OverflowError, ValueError):
                if not halvings:
                    return False
                parts += [(begin, centre, halvings - 1), (centre, end, halvings - 1)]
    return True


def _times(table: np.ndarray, number: arb) -> list[list[arb]]:
    return [[number * entry for entry in row] for row in table.tolist()]


def _sampled(
    claim: PairClaim, centre: arb, half: arb, flow: TaylorMatrix
) -> tuple[TaylorMatrix, TaylorMatrix]:
    """(z, z′, s, s′) and the acting input, and the memory after a period, by the states of the loop."""
    h, n, observed = arb(claim.period), claim.states, claim.seen is not None
    unit = TaylorMatrix.of(np.eye(n).tolist())
    state, memory = unit.rows(0, 4), 4 + 4 * observed
    estimate = state
    # (z, z′, w, w′) in seconds, of (z, z′, s, s′) in periods.
    plain = TaylorMatrix.of([[1, 0, 0, 0], [0, 1 / h, 0, 0], [1, 0, 1, 0], [0, 1 / h, 0, 1 / h]])
    back = TaylorMatrix.of([[1, 0, 0, 0], [0, h, 0, 0], [-1, 0, 1, 0], [0, -h, 0, h]])
    if claim.seen is not None and claim.table is not None and claim.filter_range is not None:
        table, (low, high) = claim.table, map(arb, claim.filter_range)

        def cosines(link: arb_series) -> list[arb_series]:
            angle = ((2 * link.log() - (low + high)) / (high - low)).acos()
            return [(k * angle).cos() for k in range(len(table))]

        series = taylor_row(cosines, centre, half) @ TaylorMatrix.of(table.tolist())
        columns = len(claim.seen)
        gain = TaylorMatrix.stacked([[series.columns(i * columns, (i + 1) * columns)] for i in range(4)])
        predicted = unit.rows(4, 8)
        seen = TaylorMatrix.of(claim.seen.tolist())
        estimate = predicted + back @ gain @ seen @ plain @ (state - predicted)
    exact = claim.seen is None or [1.0, 0.0, 0.0, 0.0] in claim.seen.tolist()
    position = (state if exact else estimate).rows(0, 1)
    before, last = unit.rows(memory, memory + 1), unit.rows(memory + 1, memory + 2)
    integral, ahead = before + (last + position).times(arb(0.5)), estimate
    waiting = [unit.rows(k, k + 1) for k in range(memory + 2, n)]
    for one in waiting:
        ahead = flow @ TaylorMatrix.stacked([[ahead], [one]])

    def poles(link: arb_series) -> list[arb_series]:
        return [arb(p) / (link + arb(p)) for p in claim.poles.tolist()] + [arb_series([1])]

    gains = taylor_row(poles, centre, half) @ TaylorMatrix.of(claim.coefficients.T.tolist())
    force = -(gains.columns(0, 4) @ plain @ ahead + gains.columns(4, 5).times(h) @ integral)
    queue = [*waiting, force]
    after = [flow @ TaylorMatrix.stacked([[estimate], [queue[0]]])] if observed else []
    after = [[part] for part in (*after, integral, position, *queue[1:])]
    return TaylorMatrix.stacked([[state], [queue[0]]]), TaylorMatrix.stacked(after)
