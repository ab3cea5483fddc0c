"""The dissipation inequality along rays from the operating point.

On a ray x = ρ v every part of V is a power of the radius: V_k(ρ v) = ρᵏ V_k(v), V_k,x(ρ v) = ρᵏ⁻¹ V_k,x(v). So
the polynomial is evaluated once per direction, and a point of the ray costs a weighted sum of a few vectors
and the exact fields there.

Search for points where the dissipation inequality fails, or V stops increasing, inside a level set of V.

Both are one question: is the largest value of

    q(x) = r(x)/|y|²    or    q(x) = −x·V_x/|y|²,    x = T y,    V_2 = c |y|²,

positive anywhere in {V ≤ c}? q is smooth, and wherever it is positive inside a level set it has a local maximum. So
q is ascended from many starts (BFGS, all starts at once), where leaving {V ≤ c} is penalised. Each violation found
this way is followed to the lowest point of its surface q = 0 (SLSQP), where a level set touches it. Sampling alone has
to hit a violation, and that is often a sliver; ascent only has to start on its slope.
"""

# Not checked strictly: SciPy has no types.
# pyright: reportMissingTypeStubs=false, reportUnknownArgumentType=false, reportUnknownLambdaType=false
# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from flexhinf.hinf.value_function import ValueFunction

_BISECTIONS = 40
_TOGETHER = 64  # points that are evaluated at once at least: of few rays several points each
_ROUNDING = 1e-11  # r up to this, relative to the largest of its terms, counts as zero
#: Rays are followed to this many times the lowest level found, to have several starts for the ascent.
_SLACK = 2.0


@dataclass(frozen=True)
class Stops:
    """Where rays stopped.

    `level`, `radius`: (N,), V at the last good point (inf for a ray that did not stop), and the radius. `point`: (N,
    n). `broken`: (N,), whether r > 0 there; otherwise V stopped increasing. `direction`: (N, n).
    """

    level: np.ndarray
    radius: np.ndarray
    point: np.ndarray
    broken: np.ndarray
    direction: np.ndarray

    def chosen(self, places: Sequence[int] | np.ndarray) -> Stops:
        """The stops of some rays."""
        return Stops(*(getattr(self, name)[places] for name in Stops.__dataclass_fields__))


@dataclass(frozen=True)
class Rays:
    """Directions with the gradient of every part of V on them.

    `direction`: (N, n). `degrees`: (K,), degrees of V that occur. `slopes`: (N, K, n), V_k,x(v). `values`: (N, K),
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
        """Rays in some of the directions."""
        return Rays(self.direction[places], self.degrees, self.slopes[places], self.values[places])

    def at(self, radius: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """x (N, n), V (N,), V_x (N, n) and V_x x (N,) at one radius per ray."""
        powers = radius[:, None] ** self.degrees
        terms = self.values * powers
        slope = np.einsum("ak,akn->an", powers / radius[:, None], self.slopes)
        return self.direction * radius[:, None], terms.sum(1), slope, terms @ self.degrees


class RayInequality:
    """r(x) ≤ 0 with the exact fields, for a checked attenuation level and penalty.

    `output`: The checked h from x (N, n) and the designed h (N, s). `root`: P^(−½) up to a rotation, (n, n): V_2 = ½
    |y|² for x = root y.
    """

    def __init__(
        self, solution: ValueFunction, gamma: float, output: Callable[[np.ndarray, np.ndarray], np.ndarray]
    ) -> None:
        self.solution, self.gamma, self.output = solution, gamma, output
        values, vectors = np.linalg.eigh(solution.P)
        sizes = np.sqrt(np.maximum(values, 1e-14 * values[-1]))
        self._inverse, self.root = vectors * sizes, vectors / sizes

    def directions(self, sphere: np.ndarray) -> np.ndarray:
        """Rays of equal V_2: unit vectors times P^(−½)."""
        return sphere / np.linalg.norm(sphere, axis=1, keepdims=True) @ self.root.T

    def on_sphere(self, points: np.ndarray) -> np.ndarray:
        """The unit vectors whose `directions` point at `points`."""
        sphere = points @ self._inverse
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

    def follow(
        self, directions: np.ndarray, radii: np.ndarray, growth: float, largest: float, cap: float
    ) -> Stops:
        """Follow every ray until it stops, passes `cap` or twice the lowest level so far, or leaves `largest`."""
        rays, count = Rays.of(self.solution, directions), len(directions)
        level, radius = np.full(count, np.inf), radii.astype(float)
        broken, last, active = np.zeros(count, bool), np.zeros(count), np.arange(count)
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

    def _along(self, rays: Rays, chosen: np.ndarray, radii: np.ndarray) -> tuple[np.ndarray, ...]:
        """V, whether r > 0, and whether V has stopped increasing, at radii (M, K) on each chosen ray, (M, K) each."""
        x, value, slope, radial = rays.chosen(np.repeat(chosen, radii.shape[1])).at(radii.ravel())
        terms = self.terms(x, slope)
        violated = ~(terms.sum(axis=0) <= _ROUNDING * np.abs(terms).max(axis=0))
        return tuple(each.reshape(radii.shape) for each in (value, violated, ~(radial > 0)))

    def _pinpoint(
        self, rays: Rays, good: np.ndarray, bad: np.ndarray, broken: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Divide the interval in which rays stop, again and again, into two parts, or into more of few rays: V at the
        last good point, the first bad radius, and whether r > 0 there."""
        each, halvings = np.arange(len(good)), max(1, int(np.log2(_TOGETHER / len(good) + 1.0)))
        for _ in range(-(-_BISECTIONS // halvings)):
            radii = good[:, None] + (bad - good)[:, None] * (np.arange(1, 2**halvings) / 2**halvings)
            _, violated, turned = self._along(rays, each, radii)
            stop = violated | turned
            first, some = stop.argmax(axis=1), stop.any(axis=1)
            known = np.hstack([good[:, None], radii, bad[:, None]])
            broken = np.where(some, violated[each, first], broken)
            place = np.where(some, first, radii.shape[1])
            good, bad = known[each, place], known[each, place + 1]
        return rays.at(np.maximum(good, 1e-300))[1], bad, broken


_DIFFERENCE = 1e-5  # step of central differences, in units of y
_LEAVING = 10.0  # penalty for leaving the level set, relative to |q| at the start
_ARMIJO = 1e-4
_SHORTEST = 1e-6  # step length at which a start counts as converged
_BOX, _BOXES = 0.2, 20  # half width of a box in which V is minimised, in units of y, and their number


@dataclass(frozen=True)
class Landscape:
    """q and its gradient in scaled coordinates y, for the inequality or for the growth of V along rays.

    `scale`: (n, n), T of x = T y. `level`: c; may be infinite. `largest`: Bound on every state. `growth`: Whether q is
    −x·V_x/|y|² instead of r/|y|².
    """

    inequality: RayInequality
    scale: np.ndarray
    level: float
    largest: float
    growth: bool

    def q(self, y: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """q (N,), its gradient (N, n), V (N,) and its gradient (N, n), at y (N, n)."""
        x = y @ self.scale.T
        parts = self.inequality.solution.gradient_parts(x)
        slope = sum(parts.values(), start=np.zeros(x.shape))
        value = sum(((part * x).sum(1) / k for k, part in parts.items()), start=np.zeros(len(x)))
        if self.growth:
            left = -(slope * x).sum(1)
            left_slope = -sum((k * part for k, part in parts.items()), start=np.zeros(x.shape)) @ self.scale
        else:
            left, left_slope = self._inequality(x, slope)
        size = (y * y).sum(1)
        q = left / size
        return q, (left_slope - 2 * q[:, None] * y) / size[:, None], value, slope @ self.scale

    def _inequality(self, x: np.ndarray, slope: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """r and its gradient in y: V_xx times the worst closed loop, and differences of the fields at constant V_x."""
        inequality, (count, n) = self.inequality, x.shape
        steps = _DIFFERENCE * self.scale.T  # one row per direction of y
        around = np.concatenate([x[:, None], x[:, None] + steps, x[:, None] - steps], axis=1)
        every = inequality.checked_fields(around.reshape(-1, n))
        rate = inequality.worst_rate(slope, tuple(values[:: 1 + 2 * n] for values in every))
        length = np.linalg.norm(np.linalg.solve(self.scale, rate.T), axis=0)
        small = (_DIFFERENCE / np.maximum(length, 1e-300))[:, None]
        _, beside = inequality.solution.value_and_gradient(
            np.concatenate([x + small * rate, x - small * rate])
        )
        bend = (beside[:count] - beside[count:]) / (2 * small)
        terms = inequality.solution.hamiltonian_terms(
            np.repeat(slope, 1 + 2 * n, axis=0), every, inequality.gamma
        )
        values = terms.sum(axis=0).reshape(count, 1 + 2 * n)
        by_y = (values[:, 1 : 1 + n] - values[:, 1 + n :]) / (2 * _DIFFERENCE)
        return values[:, 0], bend @ self.scale + by_y

    def penalised(
        self, y: np.ndarray, unit: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """−q/unit plus the penalty for leaving the level set, its gradient (N, n), q and V (N,)."""
        q, q_slope, value, slope = self.q(y)
        over = np.maximum(value / self.level - 1.0, 0.0) if np.isfinite(self.level) else np.zeros(len(y))
        x = y @ self.scale.T
        beyond = np.maximum(np.abs(x) / self.largest - 1.0, 0.0)
        cost = -q / unit + _LEAVING * (over**2 + (beyond**2).sum(1))
        by_value = (2 * _LEAVING * over / self.level)[:, None] * slope if np.isfinite(self.level) else 0.0
        by_state = (2 * _LEAVING / self.largest * beyond * np.sign(x)) @ self.scale
        return cost, -q_slope / unit[:, None] + by_value + by_state, q, value


def ascend(landscape: Landscape, starts: np.ndarray, rounds: int) -> np.ndarray:
    """The points (M, n) with q > 0 that ascent from `starts` (K, n) arrives at, by BFGS on all starts at once.

    A start ends when its q is positive inside the level set, or when its steps have become short. Each round evaluates
    q once for every start that has not ended; a step that does not improve enough is halved.
    """
    count, n = starts.shape
    y = starts.copy()
    unit = np.maximum(np.abs(landscape.q(y)[0]), 1e-300)
    cost, slope, q, value = landscape.penalised(y, unit)
    hessian = np.tile(np.eye(n), (count, 1, 1))
    direction = -slope / np.maximum(np.linalg.norm(slope, axis=1), 1e-300)[:, None] * 0.1
    length = np.ones(count)
    fresh = np.ones(count, bool)
    active = np.flatnonzero(np.isfinite(cost) & ~((q > 0) & (value <= landscape.level)))
    for _ in range(rounds):
        if len(active) == 0:
            break
        step = length[active, None] * direction[active]
        tried = y[active] + step
        with np.errstate(all="ignore"):
            new_cost, new_slope, new_q, new_value = landscape.penalised(tried, unit[active])
            better = new_cost <= cost[active] + _ARMIJO * (slope[active] * step).sum(1)
        moved, stuck = active[better], active[~better]
        length[stuck] /= 3.0
        if len(moved):
            change, bend = step[better], new_slope[better] - slope[moved]
            y[moved], cost[moved], slope[moved] = tried[better], new_cost[better], new_slope[better]
            q[moved], value[moved] = new_q[better], new_value[better]
            hessian[moved] = _updated(hessian[moved], change, bend, fresh[moved])
            fresh[moved] = False
            direction[moved] = -np.einsum("aij,aj->ai", hessian[moved], slope[moved])
            uphill = (direction[moved] * slope[moved]).sum(1) >= 0
            direction[moved[uphill]] = -slope[moved[uphill]]
            length[moved] = np.minimum(
                1.0, 0.5 / np.maximum(np.linalg.norm(direction[moved], axis=1), 1e-300)
            )
        small = length[active] * np.linalg.norm(direction[active], axis=1) < _SHORTEST
        active = active[~(small | ((q[active] > 0) & (value[active] <= landscape.level)))]
    return y[q > 0]


def _updated(inverse: np.ndarray, change: np.ndarray, bend: np.ndarray, fresh: np.ndarray) -> np.ndarray:
    curvature = (change * bend).sum(1)
    good = curvature > 1e-12 * np.linalg.norm(change, axis=1) * np.linalg.norm(bend, axis=1)
    rho = np.where(good, 1.0 / np.where(good, curvature, 1.0), 0.0)
    factor = np.where(good & fresh, curvature / np.maximum((bend * bend).sum(1), 1e-300), 1.0)
    inverse = inverse * factor[:, None, None]
    left = np.eye(change.shape[1]) - rho[:, None, None] * change[:, :, None] * bend[:, None, :]
    return (
        left @ inverse @ np.swapaxes(left, 1, 2)
        + rho[:, None, None] * change[:, :, None] * change[:, None, :]
    )


def touching_point(landscape: Landscape, start: np.ndarray) -> np.ndarray:
    """The point (n,) near `start` (n,) where V is smallest on the surface q = 0: SLSQP in boxes that move."""
    from scipy.optimize import minimize

    unit = max(float(np.linalg.norm(landscape.q(start[None])[1])), 1e-300)
    seen: dict[bytes, tuple[np.ndarray, ...]] = {}

    def at(y: np.ndarray) -> tuple[np.ndarray, ...]:
        key = y.tobytes()
        if key not in seen:
            seen[key] = landscape.q(y[None])
        return seen[key]

    point = start
    for _ in range(_BOXES):
        reference = max(float(at(point)[2][0]), 1e-300)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # of a step that SLSQP itself shortens
            outcome = minimize(
                lambda y, reference=reference: float(at(y)[2][0]) / reference,
                point,
                jac=lambda y, reference=reference: at(y)[3][0] / reference,
                constraints={
                    "type": "eq",
                    "fun": lambda y: at(y)[0] / unit,
                    "jac": lambda y: at(y)[1] / unit,
                },
                bounds=[(value - _BOX, value + _BOX) for value in point],
                method="SLSQP",
                options={"maxiter": 60, "ftol": 1e-11},
            )
        if not np.isfinite(outcome.x).all():
            break
        moved, point = np.abs(outcome.x - point).max(), outcome.x
        if moved < 0.99 * _BOX:
            break
    return point
