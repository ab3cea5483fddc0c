"""Search for storage functions of pairs: they prove which errors of masses and springs a loop of a workspace tolerates.

At a pose let the true inertia matrix M̂ of the links be between M/(1 + δ₂) and M/(1 − δ₁), and the stiffness K̂ between
(1 − ε₁) K and (1 + ε₂) K. In the coordinates of K^½ the links feel V (Λ + Λ^½ Δ Λ^½)(1 + E) Vᵀ and the motors κ (1 + E)
with symmetric constant −δ₁ ≤ Δ ≤ δ₂ and −ε₁ ≤ E ≤ ε₂. So pairs are mixed through e = E s, s = w − z, which adds to the
twist s of the spring, and through d = Δ a with a = √λ (s + e), which adds √λ d to z″. Let ˙ be the rate of a signal
times e^(αt), r = ṡ, and v = ė = E r. All such signals satisfy over a period, for weights μ ≥ 0 and all τ, ρ and c,

    ∫ (d + δ₁ a)(δ₂ a − d) + μ₁ (e + ε₁ s)(ε₂ s − e) + μ₂ (v + ε₁ r)(ε₂ r − v)
        + 2τ (d ȧ + v ṙ) + 2ρ e r − 2c e v dt  ≥  [τ (aᵀΔa + rᵀE r) + ρ sᵀE s − c eᵀe],

with Popov's multipliers [popov1961]. ȧ = √λ (r + v) and ṙ = −(λ + κ)(s + e) − √λ d + y: the product of d and v, of both
errors, falls out. The largest of V(x(h)) plus the integral over all d and v, for a pair by itself, is that of a
linear-quadratic worst. With x = (z, z′, s, s′, f, e), ẋ = M x + √λ g d + i v, t = s + e, g = z′ − s′ and i = e as unit
vectors, S = τ (r rᵀ + (λ + κ) t tᵀ) + c i iᵀ (which is added to V, so that no large number is left in the
flow), M′ = M + λ ½(δ₂ − δ₁) g tᵀ + i nᵀ and n = ½(ε₂ − ε₁) r + τ y/μ₂

    Φ′ = exp(h [ M′   λ g gᵀ + i iᵀ/μ₂ ; −Q′   −M′ᵀ ]),    W = Φ₁₂ Φ₂₂⁻¹,   Q = −Φ₂₂⁻¹ Φ₂₁,   A = Φ₂₂⁻ᵀ,
    Φ = [ 1   0 ; S   1 ] Φ′ [ 1   0 ; −S   1 ],
    Q′ = λ ¼(δ₁ + δ₂)² t tᵀ + τ (r yᵀ + y rᵀ) + μ₂ (n nᵀ + ε₁ε₂ r rᵀ) + ρ (r iᵀ + i rᵀ)
        + μ₁ (ε₁ε₂ s sᵀ + ½(ε₂ − ε₁)(s iᵀ + i sᵀ) − i iᵀ).

Where springs are exact, e and v are left out. With the memory of the controller the loop is ξ⁺ = A ξ + v, and
V_λ = ξᵀ P(λ) ξ proves stability with the rate α if P > 0 and N(λ) = [ P − Q   AᵀP ; PA   P − PWP ] > 0
(docs/theorem.md). P is linear in λ in an interval; at its ends it lies between solutions of a Riccati equation. Nothing
here is proved: `flexhinf.certify.checker.pairs` does that, and shares no code with it.

The unit of time is the period, so that all numbers have a size near one.
"""

# Not checked strictly: parts of SciPy and NumPy have no types.
# pyright: reportMissingTypeStubs=false, reportUnknownVariableType=false, reportUnknownArgumentType=false
# pyright: reportUnknownMemberType=false

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.polynomial import chebyshev
from scipy.linalg import expm

from flexhinf.modal.pair import PairGains

if TYPE_CHECKING:
    from flexhinf.estimation.modal import ModalFilter

#: log₁₀ of the multipliers, in periods; relative accuracy of a tolerance, and the smallest one.
MULTIPLIERS, ACCURACY, FIRST = (-2.5, 3.5), 0.01, 1e-4

#: First steps of log₁₀ of one multiplier, and of several.
FIRST_STEP = 0.25, 1.0

#: Distances from a mode's angle at which frequencies are looked at, in those of the mode from the unit circle.
NEAR = np.array([-3.0, -1.5, -0.7, -0.3, -0.1, 0.0, 0.1, 0.3, 0.7, 1.5, 3.0])

#: Doublings of the iteration for P; shares of the room by which Q and W are larger, and of a weight that makes P
#: definite, in units of what errors can reach.
DOUBLINGS, MORE, WEIGHT = 45, 0.05, 1e-3

#: Share of the largest eigenvalue of Y that counts as reached.
REACHED = 1e-6

#: The rooms at which a lift is looked for, and the share of an entry of P by which it clears 0; smallest log₁₀ of
#: several multipliers.
LIFTED, CLEAR, SMALLEST = (0.01, 1e-3, 1e-5), 0.05, np.array([-1.0, -4.0, -4.0, -3.0])


class Sector(NamedTuple):
    """Errors −δ₁ ≤ Δ ≤ δ₂ of the inverse inertia matrix, as shares: M/(1 + δ₂) ≤ M̂ ≤ M/(1 − δ₁)."""

    lower: float  # δ₁: 0.2 covers links that are 1/0.8 times as heavy
    upper: float  # δ₂: 0.25 covers links that are 1/1.25 times as heavy


#: No errors of one kind.
EXACT = Sector(0.0, 0.0)


class Errors(NamedTuple):
    """What is tolerated at once: errors of the inverse inertia matrix and of the stiffness, as shares."""

    masses: Sector
    springs: Sector = EXACT  # −ε₁ ≤ E ≤ ε₂: (1 − ε₁) K ≤ K̂ ≤ (1 + ε₂) K

    def and_share(self, share: float, others: Errors) -> Errors:
        """These, and a share of others beside them."""
        sums = [own + share * other for own, other in zip(self.numbers, others.numbers)]
        return Errors(Sector(*sums[:2]), Sector(*sums[2:]))

    @property
    def numbers(self) -> tuple[float, ...]:
        """δ₁, δ₂, ε₁ and ε₂."""
        return *self.masses, *self.springs

    @property
    def largest(self) -> float:
        """The largest of all, a share."""
        return max(self.numbers)

    @property
    def names(self) -> str:
        """What has errors."""
        return " and ".join(
            name for name, own in (("masses", self.masses), ("springs", self.springs)) if max(own) > 0.0
        )

    def within(self, others: Errors) -> bool:
        """Whether all are at most as large as others."""
        return all(own <= other for own, other in zip(self.numbers, others.numbers))


#: No errors; errors of masses of either sign, of the same size.
NONE, SYMMETRIC = Errors(EXACT), Errors(Sector(1.0, 1.0))


class Multipliers(NamedTuple):
    """The numbers of an integral inequality, in periods."""

    masses: float  # τ
    springs: float = 0.0  # ρ
    twist_weight: float = 0.0  # μ₁
    rate_weight: float = 0.0  # μ₂
    lift: float = 0.0  # c


class WorstPeriod(NamedTuple):
    """ξ⁺ = A ξ + v with what errors gain: the largest over v of V(A ξ + v) + ξᵀ Q ξ − vᵀ W⁻¹ v; (n, n) each."""

    a: np.ndarray
    q: np.ndarray
    w: np.ndarray


@dataclass(frozen=True, eq=False)
class SampledPairs:
    """The sampled loops of all pairs of a law: latency, and an estimator or the true state."""

    gains: PairGains
    latency: int = 0
    filter: ModalFilter | None = None

    def model(self, link: float) -> np.ndarray:
        """M (5, 5) of (z, z′, s, s′, f), in units of the period."""
        pair, h = self.gains.pair(link), self.gains.period
        m = np.zeros((5, 5))
        m[0, 1] = m[2, 3] = 1.0
        m[1, 2] = link * h**2
        m[3] = [-pair.holding * h**2, -pair.damping * h, 0.0, -pair.damping * h, pair.input * h**2]
        m[3, 2] = -(link + pair.motor + pair.holding) * h**2
        return m

    @cached_property
    def _memories(self) -> dict[float, tuple[np.ndarray, np.ndarray]]:
        return {}

    def memory(self, link: float) -> tuple[np.ndarray, np.ndarray]:
        """The state and the acting input (5, n), and the memory after a period (n − 4, n), by the n states.

        The states are (z, z′, s, s′), the filter's prediction of these, the integral in periods, the last position, and
        the inputs that wait, the next one first.
        """
        if link in self._memories:
            return self._memories[link]
        h, observed = self.gains.period, self.filter is not None
        size = 6 + self.latency + 4 * observed
        unit = np.eye(size)
        state, others = unit[:4], unit[4 + 4 * observed :]
        flow = expm(self.model(link))[:4]
        estimate, position = state, state[0]
        if self.filter is not None:
            seen, table, (low, high) = self.filter.pair
            place = np.clip((2.0 * np.log(link) - low - high) / (high - low), -1.0, 1.0)
            correction = chebyshev.chebval(place, table).reshape(4, -1)
            # Filter and gains count in (z, z′, w, w′) and in seconds.
            to_plain = np.array(
                [[1, 0, 0, 0], [0, 1 / h, 0, 0], [1, 0, 1, 0], [0, 1 / h, 0, 1 / h]], dtype=float
            )
            correction, sees = np.linalg.solve(to_plain, correction), seen @ to_plain
            estimate = unit[4:8] + correction @ sees @ (state - unit[4:8])
            if [1.0, 0.0, 0.0, 0.0] not in seen.tolist():
                position = estimate[0]
        integral, ahead = others[0] + 0.5 * (others[1] + position), estimate
        for waiting in others[2:]:
            ahead = flow @ np.vstack([ahead, waiting])
        kz, kdz, kw, kdw, ke = self.gains(link)[:5]
        gain = np.array([kz + kw, (kdz + kdw) / h, kw, kdw / h, ke * h])
        queue = np.vstack([others[2:], -gain @ np.vstack([ahead, integral])])
        predicted = [flow @ np.vstack([estimate, queue[0]])] if observed else []
        found = np.vstack([state, queue[0]]), np.vstack([*predicted, integral, position, queue[1:]])
        return self._memories.setdefault(link, found)

    def worst_period(
        self, link: float, errors: Errors, multipliers: Multipliers, rate: float = 0.0
    ) -> WorstPeriod:
        """A, Q and W of a pair, e the last of its states where springs have errors; the rate α in 1/s."""
        (lower, upper), (softer, stiffer) = errors
        tau, rho, twist_weight, rate_weight, lift = multipliers
        pair, h = self.gains.pair(link), self.gains.period
        size, alpha, both = link * h**2, rate * h, (link + pair.motor) * h**2
        (_, pushed, s, moving, _, i), model = np.eye(6), self.model(link)
        m, y = np.zeros((6, 6)), np.zeros(6)
        m[:5, :5] = model + alpha * np.eye(5)
        m[[1, 3], 5] = size, -both
        t, r, g = s + i, moving + alpha * s, pushed - moving
        y[:5] = model[3]
        y += both * s + alpha * (moving + r)
        moved = m + 0.5 * (upper - lower) * size * np.outer(g, t)
        entry, shift = size * np.outer(g, g), tau * (np.outer(r, r) + both * np.outer(t, t))
        gained = 0.25 * (lower + upper) ** 2 * size * np.outer(t, t) + tau * _twice(r, y)
        places = [0, 1, 2, 3, 5]
        if max(softer, stiffer) > 0.0:
            n = 0.5 * (stiffer - softer) * r + tau / rate_weight * y
            moved += np.outer(i, n)
            entry += np.outer(i, i) / rate_weight
            shift += lift * np.outer(i, i)
            gained += rate_weight * (np.outer(n, n) + softer * stiffer * np.outer(r, r)) + rho * _twice(r, i)
            known = softer * stiffer * np.outer(s, s) + 0.5 * (stiffer - softer) * _twice(s, i)
            gained += twist_weight * (known - np.outer(i, i))
        else:
            moved, entry, shift, gained = (part[:5, :5] for part in (moved, entry, shift, gained))
            places.pop()
        flow = expm(np.block([[moved, entry], [-gained, -moved.T]]))
        (a, b), (c, d) = (np.hsplit(part, 2) for part in np.vsplit(flow, 2))
        inverse = np.linalg.inv(shift @ b + d)
        w, q = b @ inverse, inverse @ ((shift @ b + d) @ shift - shift @ a - c)
        acting, memory = self.memory(link)
        if len(places) == 5:
            acting = np.pad(acting, (0, 1))
            acting[-1, -1] = 1.0
            memory = np.hstack([memory, np.zeros((len(memory), 1))])
        states = acting.shape[1]
        whole = np.zeros((states, states))
        kept = [*range(4), *range(states - 1, states - 5 + len(places))]
        whole[np.ix_(kept, kept)] = 0.5 * (w + w.T)[np.ix_(places, places)]
        own = inverse.T[places] @ acting
        after = np.vstack([own[:4], np.exp(alpha) * memory, own[4:]])
        return WorstPeriod(after, 0.5 * acting.T @ (q + q.T) @ acting, whole)

    def radius(self, links: Sequence[float], errors: np.ndarray, springs: np.ndarray | float = 0.0) -> float:
        """Spectral radius of pairs λ (k,) that symmetric errors Δ (k, k) of the inverse inertia, and E (k, k) of the
        stiffness, mix."""
        count, roots = len(links), np.sqrt(links) * self.gains.period
        model = _along_diagonal([*map(self.model, links)])
        acting, memory = zip(*map(self.memory, links))
        stiffness, felt = np.eye(count) + springs, errors * np.outer(roots, roots)
        added = (np.diag(roots**2) + felt) @ stiffness - np.diag(roots**2)
        model[1::5, 2::5] += added
        motor = self.gains.motor * self.gains.period**2
        model[3::5, 2::5] -= added + motor * (stiffness - np.eye(count))
        moved = (expm(model) @ _along_diagonal(acting)).reshape(count, 5, -1)[:, :4]
        kept = _along_diagonal(memory).reshape(count, len(memory[0]), -1)
        loop = np.concatenate([moved, kept], axis=1).reshape(moved.shape[2], -1)
        return float(np.abs(np.linalg.eigvals(loop)).max())

    def decay(self, link: float) -> float:
        """The rate of the slowest mode of a pair without errors, 1/s; negative where it is unstable."""
        return -float(np.log(self.radius([link], np.zeros((1, 1))))) / self.gains.period


def _along_diagonal(blocks: Sequence[np.ndarray]) -> np.ndarray:
    """Blocks of one shape along the diagonal of a matrix, as the slower `scipy.linalg.block_diag`."""
    places, (rows, columns) = range(len(blocks)), blocks[0].shape
    whole = np.zeros((len(blocks), rows, len(blocks), columns))
    whole[places, :, places] = blocks
    return whole.reshape(len(blocks) * rows, -1)


def _twice(left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """The matrix of the quadratic form 2 (left · x)(right · x)."""
    return np.outer(left, right) + np.outer(right, left)


def gain_peak(worst: WorstPeriod) -> float:
    """Largest eigenvalue over frequencies of Q seen through the loop from W^½; below 1, P exists if the loop without
    errors is stable. Computed on a grid that is fine where modes are; infinite where errors gain without bound within a
    period: W, which grows from 0, has then passed infinity."""
    modes, n = np.linalg.eigvals(worst.a), len(worst.a)
    places = np.flatnonzero(worst.w.any(axis=0))
    values, vectors = np.linalg.eigh(worst.w[np.ix_(places, places)])
    if values[0] < -1e-9 * np.abs(values).max():
        return np.inf
    far = np.maximum(np.abs(1.0 - np.abs(modes)), 1e-5)
    near = np.abs(np.angle(modes))[:, None] + np.outer(far, NEAR)
    z = np.exp(1j * np.unique(np.clip(np.r_[near.ravel(), np.geomspace(1e-4, np.pi, 40)], 1e-6, np.pi)))
    entry = np.zeros((n, len(places)))
    entry[places] = vectors * np.sqrt(np.maximum(values, 0.0))
    inner = np.linalg.solve(
        z[:, None, None] * np.eye(n) - worst.a, np.broadcast_to(entry, (len(z), *entry.shape))
    )
    return float(np.linalg.eigvalsh(inner.conj().transpose(0, 2, 1) @ worst.q @ inner)[:, -1].max())


def storage(worst: WorstPeriod) -> np.ndarray | None:
    """P (n, n), between the smallest and the largest solution of P = Q + Aᵀ P (1 − W P)⁻¹ A, as the geometric mean of
    these; None where the smallest is not positive."""
    found = _solutions(worst)
    if found is None or np.linalg.eigvalsh(found[0])[0] <= 0.0:
        return None
    smallest, y = found
    size = np.sqrt(np.maximum(np.abs(np.diag(y)), 1e-300))
    values, vectors = np.linalg.eigh(y / np.outer(size, size))
    # The largest is Y⁻¹, of states that no error reaches without bound.
    root = vectors / np.sqrt(np.maximum(values, REACHED * values[-1])) / size[:, None]
    back = (size[:, None] * vectors * np.sqrt(np.maximum(values, REACHED * values[-1]))).T
    ratios, turn = np.linalg.eigh(back @ smallest @ back.T)
    if ratios[0] <= 0.0:
        return smallest
    turned = root @ turn
    mean = (turned * np.sqrt(ratios)) @ turned.T
    return 0.5 * (mean + mean.T)


def _solutions(worst: WorstPeriod) -> tuple[np.ndarray, np.ndarray] | None:
    """The smallest P (n, n), of any sign, and the inverse of the largest, by doubling."""
    unit = np.eye(len(worst.a))
    step, p, y = worst.a, worst.q, worst.w
    try:
        for _ in range(DOUBLINGS):
            inverse, before = np.linalg.inv(unit - y @ p), (p, y)
            left = step @ inverse
            step, y, p = left @ step, y + left @ y @ step.T, p + step.T @ p @ inverse @ step
            if all(np.abs(new - old).max() < 1e-13 * np.abs(new).max() for new, old in zip((p, y), before)):
                break
    except np.linalg.LinAlgError:
        return None
    return (0.5 * (p + p.T), 0.5 * (y + y.T)) if np.isfinite(p).all() and np.isfinite(y).all() else None


def _reached(a: np.ndarray, w: np.ndarray) -> np.ndarray:
    """Σ Aᵏ W Aᵏᵀ of a stable A, by doubling."""
    for _ in range(DOUBLINGS):
        w, a = w + a @ w @ a.T, a @ a
    return w


class PopovTolerance(NamedTuple):
    """The largest errors that multipliers cover at some λ."""

    errors: Errors
    multipliers: Multipliers
    share: float  # of the shape; 0 where nothing is covered


def popov_tolerance(
    pairs: SampledPairs, shape: Errors = SYMMETRIC, count: int = 25, fixed: Errors = NONE
) -> PopovTolerance:
    """The largest multiple of some errors that multipliers cover at `count` λ, at all frequencies, beside errors of a
    fixed size; computed.

    No Δ and no E reach −1, where links are infinitely heavy or springs have no stiffness.
    """
    search = _Largest(pairs, shape, count, fixed)
    springs = max(*shape.springs, *fixed.springs) > 0.0
    best, place, sign = 0.0, (0.0, 0.0, 0.0, 0.0) if springs else (0.0,), 1.0
    for start, way in _starts(springs):
        if (share := search.share(_multipliers(start, way), best)) > best:
            best, place, sign = share, start, way
    step = FIRST_STEP[len(place) > 1]
    while best and step > 0.03:
        before = best
        for other in _neighbours(place, step):
            if (share := search.share(_multipliers(other, sign), best)) > best:
                best, place = share, other
        step *= 1.0 if len(place) > 1 and best > 1.02 * before else 0.5
    return PopovTolerance(search.errors(best), _multipliers(place, sign), best)


def _starts(springs: bool) -> list[tuple[tuple[float, ...], float]]:
    """Logarithms of multipliers, and the sign of τ, from which a search begins."""
    if springs:
        return [
            (place, 1.0) for place in product((0.0, 1.0, 2.0), (-2.0, 0.0), (-3.0, -1.0), (-1.0, 0.5, 2.0))
        ]
    return [
        ((power,), sign)
        for sign, count in ((1.0, 13), (-1.0, 5))
        for power in np.linspace(*MULTIPLIERS, count).tolist()
    ]


def _neighbours(place: tuple[float, ...], step: float) -> Iterator[tuple[float, ...]]:
    """A step along each axis, either way; of several multipliers, then all but the first together."""
    steps = np.eye(len(place))
    if len(place) > 1:
        steps = np.vstack([steps, [0.0, 1.0, 1.0, 1.0]])
    for way in (*steps, *-steps):
        other = np.array(place) + step * way
        if len(place) == 1 or (other >= SMALLEST).all():
            yield tuple(other.tolist())


def _multipliers(powers: tuple[float, ...], sign: float) -> Multipliers:
    first, *others = (10.0**power for power in powers)
    return Multipliers(sign * first, *others)


def small_gain_tolerance(pairs: SampledPairs, shape: Errors = SYMMETRIC, count: int = 25) -> Errors:
    """The largest multiple of errors of masses that is covered without a multiplier; computed at `count` λ. For a
    sector of one size this is small gain: errors may change with time, and need not be symmetric."""
    search = _Largest(pairs, shape, count, NONE)
    return search.errors(search.share(Multipliers(0.0), 0.0))


class _Largest:
    """The largest multiples of errors that multipliers cover at some λ."""

    def __init__(self, pairs: SampledPairs, shape: Errors, count: int, fixed: Errors) -> None:
        self.pairs, self.shape, self.fixed = pairs, shape, fixed
        self.links = list(map(float, pairs.gains.links(count, np.inf)))[::-1]
        self.stable = all(pairs.decay(link) > 0.0 for link in self.links)

    def errors(self, share: float) -> Errors:
        """The errors of a share."""
        return self.fixed.and_share(share, self.shape)

    def tolerates(self, share: float, multipliers: Multipliers) -> bool:
        """Whether errors of this share are covered at all λ."""
        for k, link in enumerate(self.links):
            if gain_peak(self.pairs.worst_period(link, self.errors(share), multipliers)) >= 1.0:
                self.links.insert(0, self.links.pop(k))  # the next question is likely to fail here too
                return False
        return self.stable

    def share(self, multipliers: Multipliers, above: float) -> float:
        """The largest share with multipliers, if it is larger than another one; else 0."""
        if not self.tolerates(above * (1.0 + ACCURACY) + FIRST, multipliers):
            return 0.0
        low, high = above, 1.0 / self.shape.largest
        while high - low > ACCURACY * max(low, FIRST):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if self.tolerates(middle, multipliers) else (low, middle)
        return low


@dataclass(frozen=True)
class PairStorages:
    """P(λ) with some room, so that N(λ) > 0 stays true between nodes."""

    pairs: SampledPairs
    errors: Errors
    multipliers: Multipliers
    rate: float  # α, 1/s

    def at(self, link: float, room: float) -> np.ndarray | None:
        """P (n, n), its room a share of the distance of the slowest mode from the unit circle; None where there is
        none."""
        wide = self._widened(link, room)
        return None if wide is None else storage(wide)

    def lifted(self, count: int = 12) -> PairStorages:
        """The same with a c that makes P positive at `count` λ where one does."""
        if not self.with_springs:
            return self
        low = [0.0]
        for link in map(float, self.pairs.gains.links(count, np.inf)):
            for wide in filter(None, (self._widened(link, room) for room in LIFTED)):
                if (found := _solutions(wide)) is not None:
                    p = found[0]
                    by_itself = p[-1, -1] - p[-1, :-1] @ np.linalg.solve(p[:-1, :-1], p[:-1, -1])
                    low.append(float(by_itself - CLEAR * abs(p[-1, -1])))
        return replace(self, multipliers=self.multipliers._replace(lift=2.0 * abs(min(low))))

    def _widened(self, link: float, room: float) -> WorstPeriod | None:
        """A worst period that is worse by a room; None where no P exists."""
        a, q, w = self.pairs.worst_period(link, self.errors, self.multipliers, self.rate)
        own = len(a) - self.with_springs  # e neither decays nor grows by itself
        far = 1.0 - float(np.abs(np.linalg.eigvals(a[:own, :own])).max())
        if far <= 0.0:
            return None
        reached, weight = np.diag(_reached(a[:own, :own], w[:own, :own])), np.zeros(len(a))
        weight[:own] = WEIGHT / np.maximum(reached, 1e-12 * reached.max())
        more, gained = 1.0 + MORE * room, q
        if self.with_springs:  # Q is negative for e, and pays for what lets e grow
            weight[own:] = 2.0 * MORE * self.multipliers.twist_weight
            far = min(far, self.multipliers.twist_weight)
        else:
            gained = more * q
        wide = WorstPeriod(a / (1.0 - room * far), gained + room * np.diag(weight), more * w)
        return wide if gain_peak(wide) < 1.0 else None

    @property
    def with_springs(self) -> bool:
        """Whether springs have errors."""
        return max(self.errors.springs) > 0.0
