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

Springs alone need no state e: s and e stand for a and d, with g λ − (0, 0, 0, κ, 0) for √λ g and τ/(λ + κ) for τ.
Gravity's slope adds p = Γ z, with −p in t, damped springs add b = B s′, and filters of the multiplier, which let τ
depend on frequency, add a_f and d_f: docs/theorem.md has their terms. What has no error is left out. With the memory of
the controller the loop is ξ⁺ = A ξ + v, and V_λ = ξᵀ P(λ) ξ proves stability with the rate α if P > 0 and
N(λ) = [ P − Q   AᵀP ; PA   P − PWP ] > 0. P is a polynomial of λ in an interval; at some λ it lies between solutions
of a Riccati equation. Nothing here is proved: `flexhinf.certify.checker.pairs` does that, and shares no code with it.

The unit of time is the period, so that all numbers have a size near one.
"""

# Not checked strictly: parts of SciPy and NumPy have no types.
# pyright: reportMissingTypeStubs=false, reportUnknownVariableType=false, reportUnknownArgumentType=false
# pyright: reportUnknownMemberType=false

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product
from typing import NamedTuple

import numpy as np
from scipy.linalg import expm

from flexhinf.modal.sampled_pairs import SampledPairs

#: Distances from a mode's angle at which frequencies are looked at, in those of the mode from the unit circle.
NEAR = np.array([-3.0, -1.5, -0.7, -0.3, -0.1, 0.0, 0.1, 0.3, 0.7, 1.5, 3.0])

#: Doublings of the iteration for P; shares of the room by which Q and W are larger, and of a weight that makes P
#: definite, in units of what errors can reach.
DOUBLINGS, MORE, WEIGHT = 45, 0.05, 1e-3

#: Share of its largest eigenvalue that is added to those of Y.
REACHED = 1e-7

#: The rooms at which a lift is looked for, and the share of an entry of P by which it clears 0.
LIFTED, CLEAR = (0.01, 1e-3, 1e-5), 0.05


class Sector(NamedTuple):
    """Errors −δ₁ ≤ Δ ≤ δ₂ of the inverse inertia matrix, as shares: M/(1 + δ₂) ≤ M̂ ≤ M/(1 − δ₁)."""

    lower: float  # δ₁: 0.2 covers links that are 1/0.8 times as heavy
    upper: float  # δ₂: 0.25 covers links that are 1/1.25 times as heavy


#: No errors of one kind.
EXACT = Sector(0.0, 0.0)


class Errors(NamedTuple):
    """What is tolerated at once, as shares: errors of the inverse inertia matrix and of the stiffness; and what pairs
    leave out, gravity's slope and the damping of springs, over the stiffness."""

    masses: Sector
    springs: Sector = EXACT  # −ε₁ ≤ E ≤ ε₂: (1 − ε₁) K ≤ K̂ ≤ (1 + ε₂) K
    slope: Sector = EXACT  # −γ₁ ≤ Γ ≤ γ₂: −γ₁ K ≤ ∂G/∂q ≤ γ₂ K
    damping: float = 0.0  # β, s: 0 ≤ D ≤ β K
    any_motion: bool = (
        False  # of one joint: gravity is any function with such slopes, and motions may be large
    )

    def and_share(self, share: float, others: Errors) -> Errors:
        """These, and a share of others beside them."""
        sums = [own + share * other for own, other in zip(self.numbers, others.numbers)]
        damping = self.damping + share * others.damping
        sectors = Sector(*sums[:2]), Sector(*sums[2:4]), Sector(*sums[4:])
        return Errors(*sectors, damping, self.any_motion or others.any_motion)

    @property
    def numbers(self) -> tuple[float, ...]:
        """δ₁, δ₂, ε₁, ε₂, γ₁ and γ₂."""
        return *self.masses, *self.springs, *self.slope

    @property
    def largest(self) -> float:
        """The largest of all, a share."""
        return max(self.numbers)

    @property
    def channels(self) -> tuple[bool, bool, bool]:
        """Whether springs have errors, gravity a slope, and springs damping: beside masses each adds a state to a
        pair."""
        return max(self.springs) > 0.0, max(self.slope) > 0.0, self.damping > 0.0

    @property
    def of_springs_alone(self) -> bool:
        """Whether nothing else than springs has errors."""
        return self.channels == (True, False, False) and self.masses == EXACT

    def states(self, multipliers: Multipliers) -> tuple[bool, bool, bool]:
        """Which of the channels are states; errors of springs alone, whose rate has no weight, are an input like those
        of masses."""
        springs, *others = self.channels
        return springs and multipliers.springs.rate > 0.0, others[0], others[1]

    @property
    def names(self) -> str:
        """What has errors."""
        kinds = ("masses", self.masses), ("springs", self.springs), ("gravity", self.slope)
        *others, last = [name for name, own in kinds if max(own) > 0.0] or [""]
        return f"{', '.join(others)} and {last}" if others else last

    def within(self, others: Errors) -> bool:
        """Whether all are at most as large as others."""
        within = all(own <= other for own, other in zip(self.numbers, others.numbers))
        return within and self.damping <= others.damping


#: No errors; errors of masses of either sign, of the same size.
NONE, SYMMETRIC = Errors(EXACT), Errors(Sector(1.0, 1.0))


class ChannelWeights(NamedTuple):
    """The numbers of an integral inequality for springs, or for the slope of gravity, in periods."""

    multiplier: float = 0.0  # ρ
    signal: float = 0.0  # μ₁
    rate: float = 0.0  # μ₂
    lift: float = 0.0  # c


class FilterWeights(NamedTuple):
    """The numbers of a filter 1/(s + p) through which errors of masses, or of springs alone, are seen too, in
    periods."""

    pole: float  # p
    multiplier: float  # σ: at the frequency ω τ is τ + 2σ/(ω² + p²)
    lift: float = 0.0  # c, of d_f² in the unit of d, or of e_f²


class Multipliers(NamedTuple):
    """The numbers of an integral inequality, in periods."""

    masses: float  # τ; of e and r where springs alone have errors
    springs: ChannelWeights = ChannelWeights()
    slope: ChannelWeights = ChannelWeights()
    damping: ChannelWeights = ChannelWeights()
    filters: tuple[FilterWeights, ...] = ()

    @property
    def without_gain(self) -> Multipliers:
        """The same without τ and σ."""
        return self._replace(masses=0.0, filters=tuple(one._replace(multiplier=0.0) for one in self.filters))


class WorstPeriod(NamedTuple):
    """ξ⁺ = A ξ + v with what errors gain: the largest over v of V(A ξ + v) + ξᵀ Q ξ − vᵀ W⁻¹ v; (n, n) each."""

    a: np.ndarray
    q: np.ndarray
    w: np.ndarray


def worst_period(
    pairs: SampledPairs, link: float, errors: Errors, multipliers: Multipliers, rate: float = 0.0
) -> WorstPeriod:
    """A, Q and W of a pair with the rate α in 1/s; its last states are those of `_WorstErrors`: filters, e and p."""
    h = pairs.gains.period
    rates = link * h**2, pairs.gains.pair(link).motor * h**2, rate * h
    worst = _WorstErrors(pairs.model(link), rates, errors._replace(damping=errors.damping / h), multipliers)
    extra, shift = len(worst.flow) - 5, worst.shift
    hamiltonian = np.block([[worst.flow, worst.entry], [-worst.gained, -worst.flow.T]])
    if pairs.delay:
        flow, shift = (
            _late(hamiltonian, pairs.late, rates[2]),
            np.insert(np.insert(shift, 4, 0.0, 0), 4, 0.0, 1),
        )
    else:
        flow = expm(hamiltonian)
    (a, b), (c, d) = (np.hsplit(part, 2) for part in np.vsplit(flow, 2))
    end = shift @ b + d
    inverse = np.linalg.inv(end)
    w, q = b @ inverse, inverse @ (end @ shift - shift @ a - c)
    acting, memory = pairs.memory(link)
    rows, states = len(acting), acting.shape[1] + extra
    entered = np.zeros((rows + extra, states))
    entered[:rows, : states - extra] = acting
    entered[rows:, states - extra :] = np.eye(extra)
    whole = np.zeros((states, states))
    kept, own = [*range(4), *range(states - extra, states)], [*range(4), *range(rows, rows + extra)]
    whole[np.ix_(kept, kept)] = 0.5 * (w + w.T)[np.ix_(own, own)]
    moved = inverse.T @ entered
    after_memory = np.pad(np.exp(rate * h) * memory, ((0, 0), (0, extra)))
    after = np.vstack([moved[:4], after_memory, moved[rows:]])
    return WorstPeriod(after, 0.5 * entered.T @ (q + q.T) @ entered, whole)


def _late(hamiltonian: np.ndarray, late: float, alpha: float) -> np.ndarray:
    """A flow over a period in which the input of the period before, which stands before the new one, acts until θ."""
    size = len(hamiltonian) // 2 + 1
    flow = np.eye(2 * size)
    for input, duration, growth in ((4, late, alpha * late), (5, 1.0 - late, 0.0)):
        acts = [k for k in range(size) if k != 9 - input]
        both = [*acts, *(size + k for k in acts)]
        part = np.eye(2 * size)
        part[np.ix_(both, both)] = expm(duration * hamiltonian)
        part[5, 5] *= np.exp(growth)  # the new input waits, and is one of the signals times exp(αt)
        part[size + 5, size + 5] *= np.exp(-growth)
        flow = part @ flow
    return flow


class _WorstErrors:
    """The flow of a pair within a period, of (z, z′, s, s′, f), of a_f and d_f of each filter, and of e, p and b where
    there are any; what the worst errors add to it, and what they gain, in periods."""

    def __init__(
        self,
        model: np.ndarray,
        rates: tuple[float, float, float],
        errors: Errors,
        multipliers: Multipliers,
    ) -> None:
        """`rates`: λ, κ and α."""
        (size, kappa, alpha), tau, count = rates, multipliers.masses, 5 + 2 * len(multipliers.filters)
        states = errors.states(multipliers)
        names, alone = count + sum(states), errors.channels[0] and not states[0]
        unit, none = np.eye(names), np.zeros(names)
        z, push, s, turn = unit[:4]
        left = iter(unit[count:])
        error, fall, damper = (next(left) if there else none for there in states)
        own = np.pad(model, (0, names - 5))
        stretched = s + error + damper
        twist = stretched if errors.any_motion else stretched - fall
        r, o = turn + alpha * s, push + alpha * z
        y, y_z = own[3] + (size + kappa) * s + alpha * (turn + r), alpha * (push + o)
        slope = errors.slope
        if errors.any_motion:  # p is of all that moves the link, (1 + Δ) p, and drives s alone
            y, y_z = y + size * fall, none
            slope = Sector(*(part * (1.0 + errors.masses.upper) for part in slope))
        # a and d of masses; or s and e of springs alone, where e is in ṙ with the factor λ + κ
        sector, root, weight = (
            (errors.springs, 1.0, tau / (size + kappa)) if alone else (errors.masses, np.sqrt(size), tau)
        )
        a, push_turn = root * twist, push - turn
        pushed = size * push_turn - kappa * turn if alone else root * push_turn
        self.flow = own + alpha * np.diag([1.0] * 5 + [0.0] * (names - 5))
        self.flow += np.outer(push_turn, size * (error + damper - fall)) - np.outer(
            turn, kappa * (error + damper)
        )
        self.gained = weight * _twice(r, y)
        held = size * np.outer(twist, twist) + kappa * np.outer(stretched, stretched)
        self.shift = weight * (np.outer(r, r) + held)
        mean = 0.5 * (sector.upper - sector.lower) * a
        for k, (pole, multiplier, lift) in enumerate(multipliers.filters):
            seen, answer = unit[5 + 2 * k : 7 + 2 * k]
            self.flow += np.outer(seen, twist - pole * seen) - pole * np.outer(answer, answer)
            self.gained += multiplier * _twice(answer, twist)
            self.shift += lift / root**2 * np.outer(answer, answer)
            pushed = pushed + root * answer
            mean = mean - multiplier * root * seen
        self.flow += np.outer(pushed, mean)
        self.entry = np.outer(pushed, pushed)
        self.gained += np.outer(mean, mean) + sector.lower * sector.upper * np.outer(a, a)
        if states[0]:
            self._add(error, s, r, tau * y, errors.springs, multipliers.springs)
        if states[1]:
            self._add(fall, z, o, tau * y_z, slope, multipliers.slope)
        if states[2]:
            self._damp(damper, turn, tau * (y - alpha * r), errors.damping, multipliers.damping)

    def _add(
        self,
        error: np.ndarray,
        signal: np.ndarray,
        rate: np.ndarray,
        drive: np.ndarray,
        sector: Sector,
        weights: ChannelWeights,
    ) -> None:
        """An error of a signal, a state whose rate is an error of the signal's rate; what else stands at its rate."""
        known, middle = sector.lower * sector.upper, 0.5 * (sector.upper - sector.lower)
        n = middle * rate + drive / weights.rate
        self.flow += np.outer(error, n)
        self.entry += np.outer(error, error) / weights.rate
        self.gained += weights.rate * (np.outer(n, n) + known * np.outer(rate, rate))
        self.gained += weights.signal * (
            known * np.outer(signal, signal) + middle * _twice(signal, error) - np.outer(error, error)
        )
        self.gained += weights.multiplier * _twice(rate, error)
        self.shift += weights.lift * np.outer(error, error)

    def _damp(
        self, damper: np.ndarray, turn: np.ndarray, drive: np.ndarray, size: float, weights: ChannelWeights
    ) -> None:
        """b = B s′ of a damped spring, 0 ≤ B ≤ β, a state; what stands at its rate beside that of s′."""
        n = drive / weights.rate
        self.flow += np.outer(damper, n)
        self.entry += np.outer(damper, damper) / weights.rate
        self.gained += weights.rate * np.outer(n, n)
        self.gained += weights.signal * (0.5 * size * _twice(turn, damper) - np.outer(damper, damper))
        self.shift += weights.lift * np.outer(damper, damper)


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
    z = np.exp(1j * np.unique(np.r_[near_modes(modes), np.geomspace(1e-4, np.pi, 40)]))
    entry = np.zeros((n, len(places)))
    entry[places] = vectors * np.sqrt(np.maximum(values, 0.0))
    inner = np.linalg.solve(
        z[:, None, None] * np.eye(n) - worst.a, np.broadcast_to(entry, (len(z), *entry.shape))
    )
    return float(np.linalg.eigvalsh(inner.conj().transpose(0, 2, 1) @ worst.q @ inner)[:, -1].max())


def near_modes(modes: np.ndarray) -> np.ndarray:
    """Frequencies about modes (n,) of a sampled loop, rad a period."""
    far = np.maximum(np.abs(1.0 - np.abs(modes)), 1e-5)
    near = np.abs(np.angle(modes))[:, None] + np.outer(far, NEAR)
    return np.clip(near.ravel(), 1e-6, np.pi)


class Storages(NamedTuple):
    """Solutions P, and how much room each leaves in N > 0."""

    matrices: np.ndarray  # (3, n, n)
    rooms: np.ndarray  # (3,), the least eigenvalue of N in the unit of P


def storages(worst: WorstPeriod, better: WorstPeriod) -> Storages | None:
    """P of a worst period with their rooms in N > 0 of a better one; None where there is none.

    They are the smallest solution of P = Q + Aᵀ P (1 − W P)⁻¹ A, its geometric mean with the largest, and the mean of
    both. Each is smooth in λ and θ, and the one with the most room is not.
    """
    found = _solutions(worst)
    if found is None or np.linalg.eigvalsh(found[0])[0] <= 0.0:
        return None
    smallest, far = found[0], _geometric_mean(*found)
    every = np.array([far, 0.5 * (far + smallest), smallest])
    return Storages(every, np.array([_smallest_eigenvalue(better, p) for p in every]))


def _smallest_eigenvalue(worst: WorstPeriod, p: np.ndarray) -> float:
    """The least eigenvalue of N in the unit of P; −∞ where P is not positive."""
    try:
        root = np.linalg.inv(np.linalg.cholesky(p)).T
    except np.linalg.LinAlgError:
        return -np.inf
    moved = root.T @ p @ worst.a @ root
    first, last = root.T @ (p - worst.q) @ root, root.T @ (p - p @ worst.w @ p) @ root
    return float(np.linalg.eigvalsh(np.block([[first, moved.T], [moved, last]]))[0])


def _geometric_mean(smallest: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Of the smallest solution and the largest one, Y⁻¹, as far as errors reach."""
    size = np.sqrt(np.maximum(np.abs(np.diag(y)), 1e-300))
    values, vectors = np.linalg.eigh(y / np.outer(size, size))
    # Y⁻¹ has no bound for states that no error reaches.
    kept = np.sqrt(np.maximum(values, 0.0) + REACHED * values[-1])
    root, back = vectors / kept / size[:, None], (size[:, None] * vectors * kept).T
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


@dataclass(frozen=True)
class PairStorages:
    """P(λ) with some room, so that N(λ) > 0 stays true between nodes."""

    pairs: SampledPairs
    errors: Errors
    multipliers: Multipliers
    rate: float  # α, 1/s

    def at(self, link: float, room: float, late: float = 0.0) -> Storages | None:
        """P for a θ, with a room that is a share of the distance of the slowest mode from the unit circle; None where
        there is none."""
        worst, loop = self._period(link, late)
        wide = self._widened(worst, loop, room)
        return None if wide is None else storages(wide, worst)

    def lifted(self, count: int = 12) -> PairStorages:
        """The same with numbers c that make P positive at `count` λ where some do."""
        filters, m = self.multipliers.filters, self.multipliers
        if not filters and not self._waiting:
            return self
        found: list[tuple[np.ndarray, np.ndarray]] = []
        for link, late in product(self.pairs.gains.links(count, np.inf).tolist(), self.pairs.some_late):
            worst, loop = self._period(link, late.late)
            for room in LIFTED:
                wide = self._widened(worst, loop, room)
                if wide is not None and (solutions := _solutions(wide)) is not None:
                    unit = 1.0 if self.errors.of_springs_alone else link * self.pairs.gains.period**2
                    sizes = [unit] * len(filters) + [1.0] * self._waiting
                    found.append(self._by_themselves(solutions[0], np.sqrt(sizes)))
        if not found:
            return self
        parts, own = (np.array(each) for each in zip(*found))
        size = np.sqrt(np.maximum(np.abs(np.diagonal(parts, axis1=1, axis2=2)).max(axis=0), 1e-300))
        scaled = parts / np.outer(size, size)
        beside = np.abs(scaled).sum(axis=2) - np.abs(np.diagonal(scaled, axis1=1, axis2=2))
        low = np.diagonal(parts, axis1=1, axis2=2) - CLEAR * np.abs(own) - beside * size**2
        lifts = (2.0 * np.maximum(0.0, -low.min(axis=0))).tolist()
        others = iter(lifts[len(filters) :])
        springs, slope, damping = (
            weights._replace(lift=next(others)) if there else weights
            for weights, there in zip((m.springs, m.slope, m.damping), self._states)
        )
        raised = tuple(one._replace(lift=lift) for one, lift in zip(filters, lifts))
        return replace(self, multipliers=Multipliers(m.masses, springs, slope, damping, raised))

    @property
    def _waiting(self) -> int:
        """How many of the last states, e, p and b, neither decay nor grow by themselves."""
        return sum(self._states)

    @property
    def _states(self) -> tuple[bool, bool, bool]:
        return self.errors.states(self.multipliers)

    def _by_themselves(self, p: np.ndarray, units: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Of the states that are lifted, in some units: their part of P after the others are at their best, and its
        entries."""
        extra = 2 * len(self.multipliers.filters)
        first = len(p) - extra - self._waiting
        places = [*range(first + 1, first + extra, 2), *range(first + extra, len(p))]
        others = [k for k in range(len(p)) if k not in places]
        beside = p[np.ix_(others, places)]
        part = p[np.ix_(places, places)]
        alone = part - beside.T @ np.linalg.solve(p[np.ix_(others, others)], beside)
        return alone * np.outer(units, units), np.diag(part) * units**2

    def _period(self, link: float, late: float) -> tuple[WorstPeriod, np.ndarray]:
        """The worst period, and A (n, n) without errors: the other one holds an error that the multiplier chooses, and
        need not be stable."""
        pairs = self.pairs.late_by(late)
        worst = worst_period(pairs, link, self.errors, self.multipliers, self.rate)
        return worst, worst_period(pairs, link, NONE, self.multipliers.without_gain, self.rate).a

    def _widened(self, worst: WorstPeriod, loop: np.ndarray, room: float) -> WorstPeriod | None:
        """A worst period that is worse by a room; None where no P exists."""
        a, q, w = worst
        own = len(loop)
        far = 1.0 - float(np.abs(np.linalg.eigvals(loop)).max())
        if far <= 0.0:
            return None
        reached, weight = np.diag(_reached(loop, w[:own, :own])), np.zeros(len(a))
        weight[:own] = WEIGHT / np.maximum(reached, 1e-12 * reached.max())
        more, gained = 1.0 + MORE * room, q
        if self._waiting:  # Q is negative for e, p and b, and pays for what lets them grow
            weights = self.multipliers.springs, self.multipliers.slope, self.multipliers.damping
            pays = [part.signal for part, there in zip(weights, self._states) if there]
            weight[own:] = 2.0 * MORE * np.array(pays)
            far = min(far, *pays)
        elif not self.multipliers.filters:
            gained = more * q
        wide = WorstPeriod(a / (1.0 - room * far), gained + room * np.diag(weight), more * w)
        return wide if gain_peak(wide) < 1.0 else None
