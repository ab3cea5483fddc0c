"""The dissipation inequality along rays from the operating point.

On a ray x = ρ v every part of V is a power of the radius: V_k(ρ v) = ρᵏ V_k(v), V_k,x(ρ v) = ρᵏ⁻¹ V_k,x(v). So
the polynomial is evaluated once per direction, and a point of the ray costs a weighted sum of a few vectors
and the exact fields there.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from flexhinf.hinf.value_function import ValueFunction

_BISECTIONS = 40
_TOGETHER = 64  # points that are evaluated at once at least: of few rays several points each
_ROUNDING = 1e-11  # r up to this, relative to the largest of its terms, counts as zero
_SLACK = (
    2.0  # rays are followed to this many times the lowest level found, to have several starts for the ascent
)


@dataclass(frozen=True)
class Stops:
    """Where rays stopped.

    Attributes
    ----------
    level, radius : ndarray, shape (N,)
        V at the last good point (inf for a ray that did not stop), and the radius.
    point : ndarray, shape (N, n)
    broken : ndarray of bool, shape (N,)
        Whether r > 0 there; otherwise V stopped increasing.
    direction : ndarray, shape (N, n)
    """

    level: np.ndarray
    radius: np.ndarray
    point: np.ndarray
    broken: np.ndarray
    direction: np.ndarray

    def chosen(self, places: Sequence[int] | np.ndarray) -> Stops:
        """Some of the rays."""
        return Stops(*(getattr(self, name)[places] for name in Stops.__dataclass_fields__))

    @classmethod
    def none(cls, n: int) -> Stops:
        """No rays in `n` states."""
        return cls(np.zeros(0), np.zeros(0), np.zeros((0, n)), np.zeros(0, bool), np.zeros((0, n)))


@dataclass(frozen=True)
class Rays:
    """Directions with the gradient of every part of V on them.

    Attributes
    ----------
    direction : ndarray, shape (N, n)
    degrees : ndarray of int, shape (K,)
        Degrees of V that occur.
    slopes : ndarray, shape (N, K, n)
        V_k,x(v).
    values : ndarray, shape (N, K)
        V_k(v) = V_k,x(v) v / k, by Euler.
    """

    direction: np.ndarray
    degrees: np.ndarray
    slopes: np.ndarray
    values: np.ndarray

    @classmethod
    def of(cls, solution: ValueFunction, direction: np.ndarray) -> Rays:
        """Evaluate V's parts on directions (N, n)."""
        parts = solution.gradient_parts(direction)
        degrees = np.array(list(parts))
        slopes = np.stack(list(parts.values()), axis=1)
        return cls(direction, degrees, slopes, np.einsum("akn,an->ak", slopes, direction) / degrees)

    def chosen(self, places: np.ndarray) -> Rays:
        """Some of the rays."""
        return Rays(self.direction[places], self.degrees, self.slopes[places], self.values[places])

    def at(self, radius: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """x (N, n), V (N,), V_x (N, n) and V_x x (N,) at one radius per ray."""
        powers = radius[:, None] ** self.degrees
        terms = self.values * powers
        slope = np.einsum("ak,akn->an", powers / radius[:, None], self.slopes)
        return self.direction * radius[:, None], terms.sum(1), slope, terms @ self.degrees


@dataclass(frozen=True)
class Inequality:
    """r(x) ≤ 0 with the exact fields, for a checked attenuation level and penalty.

    Attributes
    ----------
    output : callable
        The checked h from x (N, n) and the designed h (N, s).
    """

    solution: ValueFunction
    gamma: float
    output: Callable[[np.ndarray, np.ndarray], np.ndarray]
    _root: tuple[np.ndarray, np.ndarray] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        values, vectors = np.linalg.eigh(self.solution.P)
        sizes = np.sqrt(np.maximum(values, 1e-14 * values[-1]))
        object.__setattr__(self, "_root", (vectors * sizes, vectors / sizes))

    @property
    def root(self) -> np.ndarray:
        """P^(−½) up to a rotation, (n, n): V_2 = ½ |y|² for x = root y."""
        return self._root[1]

    def directions(self, sphere: np.ndarray) -> np.ndarray:
        """Rays of equal V_2: unit vectors times P^(−½)."""
        return sphere / np.linalg.norm(sphere, axis=1, keepdims=True) @ self._root[1].T

    def on_sphere(self, points: np.ndarray) -> np.ndarray:
        """The unit vectors whose `directions` point at `points`."""
        sphere = points @ self._root[0]
        return sphere / np.linalg.norm(sphere, axis=1, keepdims=True)

    def checked_fields(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Exact f, g1 and g2, and the checked h, at deviations (N, n)."""
        f, g1, g2, h = self.solution.exact_fields(x)
        return f, g1, g2, self.output(x, h)

    def terms(self, x: np.ndarray, slope: np.ndarray) -> np.ndarray:
        """The four terms of r at deviations (N, n) with gradients (N, n), shape (4, N)."""
        return self.solution.hamiltonian_terms(slope, self.checked_fields(x), self.gamma)

    def worst_rate(self, slope: np.ndarray, fields: Sequence[np.ndarray]) -> np.ndarray:
        """ẋ (N, n) under the law and the worst disturbance of the checked level: ∂r/∂(V_x)."""
        f, g1, g2, _ = fields
        disturbance = np.einsum("ai,aij->aj", slope, g1) / self.gamma**2
        priced = np.einsum("ai,aij->aj", slope, g2) @ self.solution.input_price
        return f + np.einsum("aij,aj->ai", g1, disturbance) - np.einsum("aij,aj->ai", g2, priced)

    def stopped(self, rays: Rays, radius: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """V, whether r > 0, and whether V has stopped increasing, at one radius per ray, each (N,)."""
        x, value, slope, radial = rays.at(radius)
        terms = self.terms(x, slope)
        broken = ~(terms.sum(axis=0) <= _ROUNDING * np.abs(terms).max(axis=0))
        return value, broken, ~(radial > 0)

    def march(
        self, directions: np.ndarray, radii: np.ndarray, growth: float, largest: float, cap: float
    ) -> Stops:
        """Follow every ray until it stops, passes `cap` or twice the lowest level so far, or leaves `largest`."""
        rays, count = Rays.of(self.solution, directions), len(directions)
        level, radius = np.full(count, np.inf), radii.astype(float)
        broken, last = np.zeros(count, bool), np.zeros(count)
        active = np.arange(count)
        reach = largest / np.abs(directions).max(axis=1)
        while len(active):
            ahead = max(1, _TOGETHER // len(active))
            steps = np.full((len(active), ahead), growth)
            steps[:, 0] = radius[active]
            radii = np.multiply.accumulate(steps, axis=1)
            value, violated, turned = self._along(rays, active, radii)
            going = np.arange(len(active))
            for k in range(ahead):
                stop = (violated | turned)[going, k]
                ended = active[going[stop]]
                if len(ended):
                    level[ended], radius[ended], broken[ended] = self._pinpoint(
                        rays.chosen(ended), last[ended], radii[going[stop], k], violated[going[stop], k]
                    )
                going = going[~stop & (value[going, k] < min(cap, _SLACK * level.min()))]
                further = active[going]
                last[further] = radii[going, k]
                radius[further] = radii[going, k] * growth
                going = going[radius[further] <= reach[further]]
            active = active[going]
        return Stops(level, radius, directions * radius[:, None], broken, directions)

    def _along(
        self, rays: Rays, chosen: np.ndarray, radii: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """What `stopped` gives, at several radii (M, K) on each chosen ray, (M, K) each."""
        points = self.stopped(rays.chosen(np.repeat(chosen, radii.shape[1])), radii.ravel())
        value, violated, turned = (each.reshape(radii.shape) for each in points)
        return value, violated, turned

    def _pinpoint(
        self, rays: Rays, good: np.ndarray, bad: np.ndarray, broken: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Divide the interval in which rays stop, again and again, into two parts, or into more of few rays: V at the
        last good point, the first bad radius, and whether r > 0 there."""
        each, halvings = np.arange(len(good)), max(1, int(np.log2(_TOGETHER / len(good) + 1.0)))
        for _ in range(-(-_BISECTIONS // halvings)):
            share = np.arange(1, 2**halvings) / 2**halvings
            radii = good[:, None] + (bad - good)[:, None] * share
            _, violated, turned = self._along(rays, each, radii)
            stop = violated | turned
            first, some = stop.argmax(axis=1), stop.any(axis=1)
            known = np.hstack([good[:, None], radii, bad[:, None]])
            broken = np.where(some, violated[each, first], broken)
            place = np.where(some, first, radii.shape[1])
            good, bad = known[each, place], known[each, place + 1]
        return rays.at(np.maximum(good, 1e-300))[1], bad, broken
