"""Search for storage functions of pairs that prove which errors of mass and payload the loop of a workspace tolerates.

At a pose let the true inertia matrix M̂ of the links be between M/(1 + δ₂) and M/(1 − δ₁). In the coordinates of K^½
the links feel K^½ M̂⁻¹ K^½ = V (Λ + Λ^½ Δ Λ^½) Vᵀ with a symmetric constant Δ and −δ₁ ≤ Δ ≤ δ₂. So pairs are mixed
through a = √λ (w − z) and d = Δ a, which adds √λ d to z″. All such d satisfy over a period h, for every number τ,

    ∫ e^(2αt) [(d + δ₁ a)ᵀ (δ₂ a − d) + 2τ dᵀ (ȧ + α a)] dt  ≥  τ [e^(2αt) aᵀΔa],

Popov's multiplier [popov1961]. The largest of V(x(h)) plus the integral over all d, for a pair by itself, is that of a
linear-quadratic worst. With ẋ = M x, x = (z, z′, s = w − z, s′, f), M′ = M + α, S = τ e₄e₄ᵀ (which adds τ s′² to V, so
that no large number is left in the flow), n = (½(δ₂ − δ₁) + ατ) e₃ and g = e₂ − e₄

    Φ′ = exp(h [ M′ + λ g nᵀ   λ g gᵀ ; −λ (n nᵀ + δ₁δ₂ e₃e₃ᵀ) − S M′ − M′ᵀS   −(M′ + λ g nᵀ)ᵀ ]),
    Φ = [ 1   0 ; S   1 ] Φ′ [ 1   0 ; −S   1 ],      W = Φ₁₂ Φ₂₂⁻¹,   Q = −Φ₂₂⁻¹ Φ₂₁,   A = Φ₂₂⁻ᵀ.

With the memory of the controller the loop is ξ⁺ = A ξ + v, and V_λ = ξᵀ P(λ) ξ proves stability with the rate α if
P > 0 and N(λ) = [ P − Q   AᵀP ; PA   P − PWP ] > 0 (docs/theorem.md). P is linear in λ in an interval, at whose ends it
solves a Riccati equation. Nothing here is proved: `flexhinf.certify.checker.pairs` does that, and shares no code with
it.

The unit of time is the period, so that all numbers have a size near one.
"""

# Not checked strictly: parts of SciPy and NumPy have no types.
# pyright: reportMissingTypeStubs=false, reportUnknownVariableType=false, reportUnknownArgumentType=false
# pyright: reportUnknownMemberType=false

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.polynomial import chebyshev
from scipy.linalg import block_diag, expm

from flexhinf.modal.pair import PairGains

if TYPE_CHECKING:
    from flexhinf.estimation.modal import ModalFilter

#: log₁₀ of the multipliers, in periods; relative accuracy of a tolerance, and the smallest one.
MULTIPLIERS, ACCURACY, FIRST = (-2.5, 3.5), 0.01, 1e-4

#: Distances from a mode's angle at which frequencies are looked at, in those of the mode from the unit circle.
NEAR = np.array([-3.0, -1.5, -0.7, -0.3, -0.1, 0.0, 0.1, 0.3, 0.7, 1.5, 3.0])

#: Doublings of the iteration for P; shares of the room by which Q and W are larger, and of a weight that makes P
#: definite, in units of what errors can reach.
DOUBLINGS, MORE, WEIGHT = 40, 0.05, 1e-3


class Sector(NamedTuple):
    """Errors −δ₁ ≤ Δ ≤ δ₂ of the inverse inertia matrix, as shares: M/(1 + δ₂) ≤ M̂ ≤ M/(1 − δ₁)."""

    lower: float  # δ₁: 0.2 covers links that are 1/0.8 times as heavy
    upper: float  # δ₂: 0.25 covers links that are 1/1.25 times as heavy

    def scaled(self, share: float) -> Sector:
        """Both times a share."""
        return Sector(self.lower * share, self.upper * share)


#: Errors of either sign, of the same size.
SYMMETRIC = Sector(1.0, 1.0)


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

    def worst_period(self, link: float, sector: Sector, multiplier: float, rate: float = 0.0) -> WorstPeriod:
        """A, Q and W of a pair; the multiplier τ in periods, the rate α in 1/s."""
        m, size, alpha = self.model(link), link * self.gains.period**2, rate * self.gains.period
        g, (_, _, c, moving, _) = np.array([0.0, 1.0, 0.0, -1.0, 0.0]), np.eye(5)
        m = m + alpha * np.eye(5)
        n = (0.5 * (sector.upper - sector.lower) + multiplier * alpha) * c
        shift = multiplier * np.outer(moving, moving)
        gained = size * (np.outer(n, n) + sector.lower * sector.upper * np.outer(c, c))
        gained += shift @ m + m.T @ shift
        moved = m + size * np.outer(g, n)
        flow = expm(np.block([[moved, size * np.outer(g, g)], [-gained, -moved.T]]))
        (a, b), (c, d) = (np.hsplit(part, 2) for part in np.vsplit(flow, 2))
        inverse = np.linalg.inv(shift @ b + d)
        w, q = b @ inverse, inverse @ ((shift @ b + d) @ shift - shift @ a - c)
        acting, memory = self.memory(link)
        whole = np.zeros((acting.shape[1], acting.shape[1]))
        whole[:4, :4] = 0.5 * (w + w.T)[:4, :4]
        after = np.vstack([inverse.T[:4] @ acting, np.exp(alpha) * memory])
        return WorstPeriod(after, 0.5 * acting.T @ (q + q.T) @ acting, whole)

    def radius(self, links: Sequence[float], errors: np.ndarray) -> float:
        """Spectral radius of pairs λ (k,) that a symmetric error Δ (k, k) of the inverse inertia mixes."""
        count, roots = len(links), np.sqrt(links) * self.gains.period
        model = np.asarray(block_diag(*map(self.model, links)))
        acting, memory = zip(*map(self.memory, links))
        added = errors * np.outer(roots, roots)
        model[1::5, 2::5] += added
        model[3::5, 2::5] -= added
        moved = (expm(model) @ np.asarray(block_diag(*acting))).reshape(count, 5, -1)[:, :4]
        kept = np.asarray(block_diag(*memory)).reshape(count, len(memory[0]), -1)
        loop = np.concatenate([moved, kept], axis=1).reshape(moved.shape[2], -1)
        return float(np.abs(np.linalg.eigvals(loop)).max())

    def decay(self, link: float) -> float:
        """The rate of the slowest mode of a pair without errors, 1/s; negative where it is unstable."""
        return -float(np.log(self.radius([link], np.zeros((1, 1))))) / self.gains.period


def gain_peak(worst: WorstPeriod) -> float:
    """Largest eigenvalue over frequencies of Q seen through the loop from W^½; below 1, P exists. Computed on a grid
    that is fine where modes are; infinite where A is unstable, and where errors gain without bound within a period: W,
    which grows from 0, has then passed infinity."""
    modes, n = np.linalg.eigvals(worst.a), len(worst.a)
    sizes = np.abs(modes)
    values, vectors = np.linalg.eigh(worst.w[:4, :4])
    if not sizes.max() < 1.0 or values[0] < -1e-9 * np.abs(values).max():
        return np.inf
    near = np.abs(np.angle(modes))[:, None] + np.outer(1.0 - sizes, NEAR)
    z = np.exp(1j * np.unique(np.clip(np.r_[near.ravel(), np.geomspace(1e-4, np.pi, 40)], 0.0, np.pi)))
    entry = np.zeros((n, 4))
    entry[:4] = vectors * np.sqrt(np.maximum(values, 0.0))
    inner = np.linalg.solve(z[:, None, None] * np.eye(n) - worst.a, np.broadcast_to(entry, (len(z), n, 4)))
    return float(np.linalg.eigvalsh(inner.conj().transpose(0, 2, 1) @ worst.q @ inner)[:, -1].max())


def storage(worst: WorstPeriod) -> np.ndarray | None:
    """P (n, n), the smallest solution of P = Q + Aᵀ P (1 − W P)⁻¹ A, by doubling; None where there is none."""
    unit = np.eye(len(worst.a))
    step, p, other = worst.a, worst.q, -worst.w
    try:
        for _ in range(DOUBLINGS):
            inverse, before = np.linalg.inv(unit + other @ p), p
            left = step @ inverse
            step, other, p = left @ step, other + left @ other @ step.T, p + step.T @ p @ inverse @ step
            if np.abs(p - before).max() < 1e-13 * np.abs(p).max():
                break
    except np.linalg.LinAlgError:
        return None
    p = 0.5 * (p + p.T)
    return p if np.isfinite(p).all() and np.linalg.eigvalsh(p)[0] > 0.0 else None


def _reached(a: np.ndarray, w: np.ndarray) -> np.ndarray:
    """Σ Aᵏ W Aᵏᵀ of a stable A, by doubling."""
    for _ in range(DOUBLINGS):
        w, a = w + a @ w @ a.T, a @ a
    return w


class PopovTolerance(NamedTuple):
    """The largest sector that a multiplier covers at some λ."""

    sector: Sector
    multiplier: float  # τ, periods


def popov_tolerance(pairs: SampledPairs, shape: Sector = SYMMETRIC, count: int = 25) -> PopovTolerance:
    """The largest multiple of a sector that one multiplier covers at `count` λ, at all frequencies; computed.

    No Δ reaches −1, where links are infinitely heavy.
    """
    search = _Largest(pairs, shape, count)
    best, place = 0.0, (0.0, 1.0)
    for sign in (1.0, -1.0):
        for power in np.linspace(*MULTIPLIERS, 13 if sign > 0.0 else 5).tolist():
            if (share := search.share(sign * 10.0**power, best)) > best:
                best, place = share, (power, sign)
    step = (MULTIPLIERS[1] - MULTIPLIERS[0]) / 24.0
    while best and step > 0.03:
        power, sign = place
        for other in (power - step, power + step):
            if (share := search.share(sign * 10.0**other, best)) > best:
                best, place = share, (other, sign)
        step *= 0.5
    return PopovTolerance(shape.scaled(best), place[1] * 10.0 ** place[0])


def small_gain_tolerance(pairs: SampledPairs, shape: Sector = SYMMETRIC, count: int = 25) -> Sector:
    """The largest multiple of a sector that is covered without a multiplier; computed at `count` λ. For a sector of one
    size this is small gain: errors may change with time, and need not be symmetric."""
    return shape.scaled(_Largest(pairs, shape, count).share(0.0, 0.0))


class _Largest:
    """The largest multiples of a sector that multipliers cover at some λ."""

    def __init__(self, pairs: SampledPairs, shape: Sector, count: int) -> None:
        self.pairs, self.shape = pairs, shape
        self.links = list(map(float, pairs.gains.links(count, np.inf)))[::-1]

    def tolerates(self, share: float, multiplier: float) -> bool:
        """Whether errors of this share are covered at all λ."""
        for k, link in enumerate(self.links):
            if gain_peak(self.pairs.worst_period(link, self.shape.scaled(share), multiplier)) >= 1.0:
                self.links.insert(0, self.links.pop(k))  # the next question is likely to fail here too
                return False
        return True

    def share(self, multiplier: float, above: float) -> float:
        """The largest share with a multiplier, if it is larger than another one; else 0."""
        if not self.tolerates(above * (1.0 + ACCURACY) + FIRST, multiplier):
            return 0.0
        low, high = above, min(1.0, *(1.0 / part for part in self.shape if part > 0.0))
        while high - low > ACCURACY * max(low, FIRST):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if self.tolerates(middle, multiplier) else (low, middle)
        return low


@dataclass(frozen=True)
class PairStorages:
    """P(λ) with some room, so that N(λ) > 0 stays true between nodes."""

    pairs: SampledPairs
    sector: Sector
    multiplier: float  # τ, periods
    rate: float  # α, 1/s

    def at(self, link: float, room: float) -> np.ndarray | None:
        """P (n, n), its room a share of the distance of the slowest mode from the unit circle; None where there is
        none."""
        a, q, w = self.pairs.worst_period(link, self.sector, self.multiplier, self.rate)
        far = 1.0 - float(np.abs(np.linalg.eigvals(a)).max())
        if far <= 0.0:
            return None
        reached = np.diag(_reached(a, w))
        weight = np.diag(WEIGHT / np.maximum(reached, 1e-12 * reached.max()))
        more = 1.0 + MORE * room
        wide = WorstPeriod(a / (1.0 - room * far), more * q + room * weight, more * w)
        return storage(wide) if gain_peak(wide) < 1.0 else None
