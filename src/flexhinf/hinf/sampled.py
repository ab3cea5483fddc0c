"""Where the truncated solution can be trusted, judged by looking at points: a `SampledCheck`, not a proof.

With the exact fields, u = −R2⁻¹ g2ᵀ V_xᵀ satisfies V̇ ≤ ½ γ²|d|² − ½ |z|² wherever

    r(x) = V_x f + ½ hᵀh + ½ V_x (g1 g1ᵀ/γ² − g2 R2⁻¹ g2ᵀ) V_xᵀ ≤ 0.

For the designed γ and h, r is a remainder of either sign. So a weaker pair is checked, a larger γ and a
smaller penalty: the difference is the margin that makes r strictly negative near the operating point. Rays
are followed outwards while V increases along them and r ≤ 0; the lowest level at which one of them stops is
then lowered further by ascent over directions.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from numbers import Integral, Real

import numpy as np

from flexhinf.errors import InvalidInput
from flexhinf.hinf.rays import Inequality, Stops
from flexhinf.hinf.step_amplitude import step_amplitude
from flexhinf.hinf.value_function import ValueFunction
from flexhinf.notebook import Summarised, number_text

__all__ = ["GAMMA_MARGIN", "PENALTY_MARGIN", "SampledCheck", "sample_region"]

GAMMA_MARGIN = 1.1  # default: checked gamma over designed gamma
PENALTY_MARGIN = 0.9  # default: checked penalty over designed penalty

_SMALLEST, _GROWTH = 1e-4, 1.08  # first deviation looked at, and its growth from point to point along a ray
_STARTS, _APART = 16, 0.95  # starts of the ascent, and the cosine of the angle they must keep from each other
_OFFSPRING, _ROUNDS = 16, 30  # variations of each start, rounds

Penalty = Callable[[np.ndarray], np.ndarray] | Mapping[str, float] | Sequence[float] | np.ndarray


@dataclass(frozen=True, eq=False, repr=False)
class SampledCheck(Summarised):
    """The largest level set {V ≤ level} around 0 on which nothing against it was found.

    Attributes
    ----------
    solution : ValueFunction
    gamma : float
        The checked attenuation level.
    margin : str
        How the checked pair differs from the designed one.
    level : float
        Infinite if no ray stopped within `largest`.
    worst_point : ndarray, shape (n,)
        Deviation at which the limiting ray stopped.
    limit : str
        Why it stopped: "inequality", "V stops increasing", or "nothing found".
    rays, seed : int
    largest : float
        Largest deviation (in any state) that was looked at.
    """

    solution: ValueFunction
    gamma: float
    margin: str
    level: float
    worst_point: np.ndarray
    limit: str
    rays: int
    seed: int
    largest: float

    def step_amplitude(
        self, moved: str | Mapping[str, float] | None = None, integrals: Sequence[str] | None = None
    ) -> float:
        """Largest rest-to-rest step whose start lies in the level set; see `flexhinf.hinf.step_amplitude`."""
        return step_amplitude(self.solution, self.level, moved, integrals)

    def summary(self) -> dict[str, str]:
        """Level, limit, checked pair and number of rays, for ``repr``."""
        return {
            "level of V": number_text(self.level),
            "limited by": self.limit,
            "checked gamma": number_text(self.gamma),
            "checked pair": self.margin,
            "rays": f"{self.rays}, not a proof",
        }

    def report(self) -> str:
        """Level, limiting point and checked pair as text."""
        names = ", ".join(
            f"{name} = {value:.4g}"
            for name, value in zip(self.solution.state_names, self.worst_point, strict=True)
        )
        return "\n".join(
            [
                f"sampled check, {self.rays} rays and ascent on the worst (seed {self.seed}); not a proof",
                f"checked: gamma = {self.gamma:.6g}; {self.margin}",
                f"largest level set: V <= {self.level:.6g}, limited by: {self.limit}",
                f"worst point (deviation): {names}",
            ]
        )


def sample_region(
    solution: ValueFunction,
    gamma: float | None = None,
    penalty: Penalty | None = None,
    *,
    rays: int = 4000,
    seed: int = 0,
    largest: float = 1e3,
) -> SampledCheck:
    """Follow rays, then lower the worst level by ascent: what `HJISolution.sampled_region` does."""
    checked_gamma = GAMMA_MARGIN * solution.gamma if gamma is None else gamma
    whole = all(isinstance(count, Integral) for count in (rays, seed))
    real = all(isinstance(number, Real) for number in (checked_gamma, largest))
    if not (whole and real and checked_gamma >= solution.gamma and rays > 0 <= seed and largest > _SMALLEST):
        raise InvalidInput(
            "The check cannot be made with these numbers.",
            f"expected gamma ≥ the designed {solution.gamma:.6g}, whole rays ≥ 1 and seed ≥ 0, "
            f"largest > {_SMALLEST}, got {checked_gamma!r}, {rays!r}, {seed!r} and {largest!r}",
            "a weaker level than the designed one, for example 1.1 times it",
        )
    output, words = _checked_penalty(solution, penalty)
    infinite = not np.isfinite(solution.gamma)
    level = "gamma = inf" if infinite else f"{checked_gamma / solution.gamma:.4g} times the designed gamma"
    margin = f"{level}, {words}"
    game = Inequality(solution, checked_gamma, output)
    rng = np.random.default_rng(seed)
    directions = game.directions(rng.standard_normal((rays, len(solution.P))))
    start = _SMALLEST / np.median(np.abs(directions).max(axis=1))
    radii = np.full(rays, start)
    found = game.march(directions, radii, _GROWTH, largest, np.inf)
    found = _lowered(game, found, largest, rng)
    worst = int(np.argmin(found.level))
    if not np.isfinite(found.level[worst]):
        return SampledCheck(
            solution,
            float(checked_gamma),
            margin,
            np.inf,
            np.zeros(len(solution.P)),
            "nothing found",
            rays,
            seed,
            largest,
        )
    reason = "inequality" if found.broken[worst] else "V stops increasing"
    level = float(found.level[worst]) if found.radius[worst] > start else 0.0
    return SampledCheck(
        solution, float(checked_gamma), margin, level, found.point[worst], reason, rays, seed, largest
    )


def _checked_penalty(
    solution: ValueFunction, penalty: Penalty | None
) -> tuple[Callable[[np.ndarray, np.ndarray], np.ndarray], str]:
    """A function (x, designed h) → checked h, and its description."""
    n = len(solution.P)
    if penalty is None:
        return lambda x, h: PENALTY_MARGIN * h, f"{PENALTY_MARGIN} times the designed penalty"
    if callable(penalty):
        return lambda x, h: penalty(x), "a given penalty function"
    if isinstance(penalty, Mapping):
        unknown = sorted(set(penalty) - set(solution.state_names))
        if unknown:
            raise InvalidInput(
                "The penalty names a state that does not exist.",
                f"expected names among {', '.join(solution.state_names)}, got {', '.join(unknown)}",
                "the names of the problem's states",
            )
        penalty = [penalty.get(name, 0.0) for name in solution.state_names]
    try:
        weights = np.asarray(penalty, dtype=float)
    except (TypeError, ValueError):
        weights = np.full(n, np.nan)
    matrix: np.ndarray = np.diag(weights) if weights.ndim == 1 else weights
    if matrix.ndim != 2 or matrix.shape[1] != n or not np.isfinite(matrix).all():
        raise InvalidInput(
            "The penalty does not fit the states.",
            f"expected {n} finite weights or a matrix with {n} columns, got shape {weights.shape}: {penalty!r}",
            "one weight per state, or {name: weight}",
        )
    return lambda x, h: x @ matrix.T, f"penalty weights {np.array2string(weights, precision=6)}"


def _diverse(game: Inequality, found: Stops) -> np.ndarray:
    """The rays that stopped lowest, no two of them close to each other."""
    chosen: list[int] = []
    sphere = game.on_sphere(found.direction)
    for index in np.argsort(found.level):
        if not np.isfinite(found.level[index]) or len(chosen) == _STARTS:
            break
        if all(sphere[index] @ sphere[other] < _APART for other in chosen):
            chosen.append(int(index))
    return np.array(chosen, dtype=int)


def _lowered(game: Inequality, found: Stops, largest: float, rng: np.random.Generator) -> Stops:
    """Vary the directions of the worst rays, keep for each what stops at a lower level, narrow down."""
    starts = _diverse(game, found)
    if len(starts) == 0:
        return found
    elite = found.chosen(starts)
    spread = 0.3
    for _ in range(_ROUNDS):
        sphere = np.repeat(game.on_sphere(elite.direction), _OFFSPRING, axis=0)
        varied = sphere + spread * rng.standard_normal(sphere.shape) / np.sqrt(sphere.shape[1])
        inside = 0.7 * np.repeat(elite.radius, _OFFSPRING)
        tried = game.march(game.directions(varied), inside, 1.03, largest, float(elite.level.max()))
        levels = np.hstack([elite.level[:, None], tried.level.reshape(len(starts), _OFFSPRING)])
        best = np.argmin(levels, axis=1)
        places = np.where(
            best == 0, np.arange(len(starts)), len(starts) + np.arange(len(starts)) * _OFFSPRING + best - 1
        )
        improved = levels.min() < elite.level.min() * (1 - 1e-3)
        elite = elite.joined(tried).chosen(places)
        spread *= 1.0 if improved else 0.75
    return found.joined(elite)
