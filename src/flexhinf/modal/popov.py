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
linear-quadratic worst, of which `flexhinf.modal.pair_period` has the Hamiltonian matrix. So that no large number is
left in the flow, S = τ (r rᵀ + (λ + κ) t tᵀ) + c e eᵀ with t = s + e is added to V: what τ leaves is 2τ (r + v) y, and

    Φ = [ 1   0 ; S   1 ] Φ′ [ 1   0 ; −S   1 ],    W = Φ₁₂ Φ₂₂⁻¹,   Q = −Φ₂₂⁻¹ Φ₂₁,   A = Φ₂₂⁻ᵀ.

Springs alone need no state e: s and e stand for a and d, with τ/(λ + κ) for τ. Gravity's slope adds p = Γ z, with −p in
t, damped springs add b = B s′, unlike motors N and Φ, and filters of the multiplier, which let τ depend on frequency,
a_f and d_f: docs/theorem.md has their terms. What has no error is left out. With the memory of the controller the loop
is ξ⁺ = A ξ + v, and V_λ = ξᵀ P(λ) ξ proves stability with the rate α if P > 0 and
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

from flexhinf.modal.pair_errors import (
    NONE,
    Errors,
    Multipliers,
)
from flexhinf.modal.pair_period import WorstPeriod, worst_period
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


def gain_peak(worst: WorstPeriod) -> float:
    """Largest eigenvalue over frequencies of Q seen through the loop from W^½; below 1, P exists if the loop without
    errors is stable. Computed on a grid that is fine where modes are; infinite where errors gain without bound within a
    period: W, which grows from 0, has then passed infinity."""
    return float(gains_at(worst, seen_frequencies(worst)).max())


def seen_frequencies(worst: WorstPeriod) -> np.ndarray:
    """Frequencies from 0 to half that of the samples, rad a period, dense where modes are; (f,), ascending."""
    return np.unique(np.r_[near_modes(np.linalg.eigvals(worst.a)), np.geomspace(1e-4, np.pi, 40)])


def gains_at(worst: WorstPeriod, frequencies: np.ndarray) -> np.ndarray:
    """The largest eigenvalue at each frequency, (f,), as of `gain_peak`."""
    n, places = len(worst.a), np.flatnonzero(worst.w.any(axis=0))
    values, vectors = np.linalg.eigh(worst.w[np.ix_(places, places)])
    if values[0] < -1e-9 * np.abs(values).max():
        return np.full(len(frequencies), np.inf)
    z = np.exp(1j * frequencies)
    entry = np.zeros((n, len(places)))
    entry[places] = vectors * np.sqrt(np.maximum(values, 0.0))
    inner = np.linalg.solve(
        z[:, None, None] * np.eye(n) - worst.a, np.broadcast_to(entry, (len(z), *entry.shape))
    )
    return np.linalg.eigvalsh(inner.conj().transpose(0, 2, 1) @ worst.q @ inner)[:, -1]


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
        filters, m = self.multipliers.every_filter, self.multipliers
        if not filters and not self._waiting:
            return self
        found: list[tuple[np.ndarray, np.ndarray]] = []
        for link, late in product(self.pairs.gains.links(count, np.inf).tolist(), self.pairs.some_late):
            worst, loop = self._period(link, late.late)
            for room in LIFTED:
                wide = self._widened(worst, loop, room)
                if wide is not None and (solutions := _solutions(wide)) is not None:
                    unit = 1.0 if self.errors.of_springs_alone else link * self.pairs.gains.period**2
                    others = len(filters) - len(m.filters) + self._waiting
                    sizes = [unit] * len(m.filters) + [1.0] * others
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
        own, motors = len(m.filters), m.motors
        if motors is not None:
            of_twist = own + len(motors.filters)
            of_errors = of_twist + len(motors.error_filters)
            motors = motors._replace(filters=raised[own:of_twist], error_filters=raised[of_twist:of_errors])
        of_slope = raised[len(raised) - len(m.prediction_filters) :]
        return replace(
            self, multipliers=Multipliers(m.masses, springs, slope, damping, raised[:own], motors, of_slope)
        )

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
        extra = 2 * len(self.multipliers.every_filter)
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
        alone = pairs.with_alike_motors
        return worst, worst_period(alone, link, NONE, self.multipliers.without_gain, self.rate).a

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
        elif not self.multipliers.every_filter:
            gained = more * q
        wide = WorstPeriod(a / (1.0 - room * far), gained + room * np.diag(weight), more * w)
        return wide if gain_peak(wide) < 1.0 else None
