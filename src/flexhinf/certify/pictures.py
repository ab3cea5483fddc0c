"""Data of a certificate's figures: slices of the region with r on them, and a step with the worst disturbance.

None of this is part of the theorem; it shows what is in it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flexhinf.certify.claim import Claim, Start
from flexhinf.certify.evaluation import path_start, path_states
from flexhinf.certify.starts import longest_run
from flexhinf.hinf.rays import Inequality
from flexhinf.hinf.sampled import CheckedPenalty, checked_pair, sample_region
from flexhinf.hinf.value_function import ValueFunction

#: Points of a surface along each side, and its sides over where the proved region is expected to end.
POINTS, WIDTH_FACTOR = 121, 1.25

#: A plane's second direction keeps this from the first (1 − cosine, V_2 as the metric); how far the plane is looked at.
APART, FURTHEST = 0.1, 4.0

#: A step that is shown with a disturbance has this share of the largest proved amplitude: the rest is for d.
SHARE = 0.8

#: Samples of the run with a disturbance.
SAMPLES = 1000


@dataclass(frozen=True, eq=False)
class Slice:
    """V and r + αV (B, A) on a surface through the goal with the coordinates `across` (A,) and `up` (B,)."""

    across: np.ndarray
    up: np.ndarray
    value: np.ndarray
    residual: np.ndarray

    @property
    def rate(self) -> np.ndarray:
        """r/V, 1/s, shape (B, A): how fast V falls beyond what the gain needs, negative; nan where V ≤ 0."""
        positive = self.value > 0.0
        return np.where(positive, self.residual / np.where(positive, self.value, 1.0), np.nan)

    def worst(self, level: float) -> tuple[float, float, float]:
        """Where r/V is largest among the points with V ≤ level: across, up, and r/V."""
        inside = np.where(self.value <= level, self.rate, np.nan)
        place = np.unravel_index(int(np.nanargmax(inside)), inside.shape)
        return float(self.across[place[1]]), float(self.up[place[0]]), float(inside[place])


@dataclass(frozen=True, eq=False)
class StartSurface(Slice):
    """Equilibria at −a with an integrator at e, where steps from rest to rest start: `across` is a, `up` is e.

    `paths` are a and e (N, 2) of the proved starts, in the order of the certificate's.
    """

    paths: tuple[np.ndarray, ...]


@dataclass(frozen=True, eq=False)
class LimitSlice(Slice):
    """The plane through the goal, the point that limits the sampled level (`up` = 1) and another one (`across` = 1).

    The other one is the largest proved start, or where that lies near the first, a unit of one state with the others
    where V_2 is smallest.
    """

    limit: str  # what fails there, as `SampledCheck.limit`
    point: np.ndarray  # (n,): deviation at which the level ends
    moved: int | None  # place of the state that is moved, None for the largest start


@dataclass(frozen=True, eq=False)
class WorstStep:
    """A step from rest with the disturbance that V says is worst, d = g1ᵀV_xᵀ/γ², for as long as the budget lasts."""

    rule: str
    amplitude: float
    time: np.ndarray  # (N,), s
    state: np.ndarray  # (N, n), deviations from the goal
    disturbance: np.ndarray  # (N, w)
    value: np.ndarray  # V
    spent: np.ndarray  # ½γ²∫|d|² until then


def start_surface(
    solution: ValueFunction, certificate: Claim, penalty: CheckedPenalty | None = None
) -> StartSurface | None:
    """V and r where steps start; None without starts, or with other than one integrator."""
    chosen = [(start, [i for i, row in enumerate(start.table) if row]) for start in certificate.starts]
    if not chosen or any(len(free) != 1 for _, free in chosen):
        return None
    start, (integral,) = max(chosen, key=lambda pair: pair[0].amplitude)
    paths = tuple(np.column_stack([s.amplitudes, s.table[free[0]]]) for s, free in chosen)
    width = WIDTH_FACTOR * max(start.amplitude, float(max(path[:, 0].max() for path in paths)))
    curvature = float(np.linalg.inv(solution.P)[integral, integral])
    height = WIDTH_FACTOR * max(
        np.sqrt(2.0 * certificate.level * curvature), max(float(np.abs(p[:, 1]).max()) for p in paths)
    )
    a, e = np.linspace(-width, width, POINTS), np.linspace(-height, height, POINTS)
    points = np.repeat(path_states(start, certificate.middle, a)[None], POINTS, axis=0)
    points[:, :, integral] = e[:, None]
    return StartSurface(a, e, *_on(solution, certificate, penalty, points), paths)


def limit_slice(
    solution: ValueFunction, certificate: Claim, penalty: CheckedPenalty | None = None
) -> LimitSlice | None:
    """The plane in which the sampled level ends; None where sampling finds no end."""
    check = sample_region(solution, certificate.gamma, penalty)
    if check is None or not 0.0 < check.level < np.inf:
        return None
    point, least = check.worst_point, np.linalg.inv(solution.P)

    def apart(choice: tuple[np.ndarray, int | None]) -> float:
        x = choice[0]
        sizes = np.sqrt((x @ solution.P @ x) * (point @ solution.P @ point))
        return 1.0 - float(abs(x @ solution.P @ point) / sizes)

    starts = [path_start(certificate, start, start.amplitude) for start in certificate.starts]
    choices: list[tuple[np.ndarray, int | None]] = [
        (x, None) for x in sorted(starts, key=lambda x: -float(solution.value(x)))[:1]
    ]
    choices += [(least[:, i] / least[i, i], i) for i in range(len(least))]
    other, moved = next((choice for choice in choices if apart(choice) > APART), max(choices, key=apart))

    angle = np.linspace(0.0, np.pi, 91)  # how far {V ≤ level} goes in this plane, along rays from the goal
    unit = np.column_stack([np.cos(angle), np.sin(angle)])
    ends = np.array([np.sqrt(2.0 * certificate.level / (x @ solution.P @ x)) for x in (other, point)])
    plane = np.linspace(0.0, FURTHEST, 200)[1:, None, None] * unit * ends
    value = np.asarray(solution.value((plane @ np.array([other, point])).reshape(-1, len(point))))
    inside = np.logical_and.accumulate(value.reshape(plane.shape[:2]) <= certificate.level, axis=0)
    lengths = (float(np.abs(plane[..., k][inside]).max(initial=0.1)) for k in (0, 1))
    across, up = (np.linspace(-WIDTH_FACTOR * length, WIDTH_FACTOR * length, POINTS) for length in lengths)
    points = across[:, None] * other + up[:, None, None] * point
    value, residual = _on(solution, certificate, penalty, points)
    return LimitSlice(across, up, value, residual, check.limit, point, moved)


def _on(
    solution: ValueFunction, certificate: Claim, penalty: CheckedPenalty | None, points: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """V and r + αV at deviations (B, A, n), each (B, A)."""
    flat = points.reshape(-1, points.shape[-1])
    pair = checked_pair(solution, certificate.gamma, penalty)
    value, slope = solution.value_and_gradient(flat)
    terms = Inequality(solution, pair.gamma, pair.output).terms(flat, slope)
    residual = terms.sum(axis=0) + certificate.decay * value
    return value.reshape(points.shape[:-1]), residual.reshape(points.shape[:-1])


def worst_step(solution: ValueFunction, certificate: Claim, start: Start) -> WorstStep:
    """The step of `SHARE` times the largest proved amplitude of a path, with the worst disturbance.

    Where the dissipation inequality is an equality, d = g1ᵀV_xᵀ/γ² maximises V̇ − ½γ²|d|². It acts from the
    beginning and ends where V(x0) + ½γ²∫|d|² reaches the proved level.
    """
    amplitude = SHARE * start.amplitude
    x = path_start(certificate, start, amplitude)
    h, gamma, level = longest_run(solution) / 8.0 / SAMPLES, certificate.gamma, certificate.level
    first = float(solution.value(x))

    def rates(x: np.ndarray, on: bool) -> tuple[np.ndarray, np.ndarray]:
        """(ẋ, d)."""
        f, g1, g2, _ = solution.exact_fields(x[None])
        d = g1[0].T @ solution.gradient(x) / gamma**2 if on else np.zeros(g1.shape[2])
        return f[0] + g1[0] @ d + g2[0] @ solution.inputs(x[None])[0], d

    rows, spent, on = [], 0.0, True
    for k in range(SAMPLES + 1):
        rate, d = rates(x, on)
        on = on and first + spent + 0.5 * gamma**2 * h * float(d @ d) < level
        if not on and d.any():
            rate, d = rates(x, on)
        rows.append((k * h, x, d, float(solution.value(x)), spent))
        energy = float(d @ d)
        a, da = rates(x + 0.5 * h * rate, on)
        b, db = rates(x + 0.5 * h * a, on)
        c, dc = rates(x + h * b, on)
        x = x + h / 6.0 * (rate + 2.0 * a + 2.0 * b + c)
        spent += 0.5 * gamma**2 * h / 6.0 * float(energy + 2.0 * da @ da + 2.0 * db @ db + dc @ dc)
    return WorstStep(start.rule, amplitude, *(np.array(column) for column in zip(*rows)))
