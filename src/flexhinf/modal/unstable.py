"""Search for the smallest symmetric error of the inverse inertia or the stiffness that destabilises a loop of pairs.

It looks from the other side at what `popov` tolerates: what it finds is unstable, by the eigenvalues of the sampled
loop, and no proof can reach it.
"""

# Not checked strictly: parts of SciPy and NumPy have no types.
# pyright: reportMissingTypeStubs=false, reportUnknownVariableType=false, reportUnknownArgumentType=false
# pyright: reportUnknownMemberType=false

from __future__ import annotations

from collections.abc import Callable
from itertools import combinations_with_replacement
from typing import NamedTuple

import numpy as np

from flexhinf.arrays import Vector
from flexhinf.modal.sampled_pairs import SampledPairs

#: Largest error that is tried: links of a quarter of their mass, springs four times as stiff.
LIGHTEST = 3.0

#: λ and turns of a grid for two pairs, the places from which the search climbs, and bisections; its steps.
LINKS, TURNS, CLIMBED, BISECTIONS = 14, 8, 5, 12
CLIMB = {"maxiter": 150, "xatol": 1e-4, "fatol": 1e-7}


class UnstableError(NamedTuple):
    """A symmetric error, Δ of the inverse inertia or E of the stiffness, with which pairs are unstable."""

    # ‖Δ‖, a share; infinite where none is found; of one pair negative where its link is too heavy, its spring too soft
    error: float
    links: tuple[float, ...]  # λ of the pairs, 1/s²
    turn: float  # φ of two pairs, rad: Δ = ‖Δ‖ [cos 2φ, sin 2φ; sin 2φ, −cos 2φ]
    radius: float  # the largest modulus of the loop's poles in the z plane

    @property
    def size(self) -> float:
        """‖Δ‖."""
        return abs(self.error)


def smallest_unstable(
    pairs: SampledPairs, mixed: bool = True, count: int = 60, of_springs: bool = False
) -> UnstableError:
    """The smallest symmetric error that is found to destabilise one pair, or two that it mixes: of the inverse inertia,
    or of the stiffness.

    Of one pair at `count` λ: errors of either sign grow in steps up to −1 and `LIGHTEST`. Of two pairs the eigenvalues
    of Δ are ±‖Δ‖: the radius is climbed by Nelder and Mead's method from the worst places of a grid.
    """
    best = UnstableError(np.inf, (), 0.0, 0.0)
    for link in map(float, pairs.gains.links(count, np.inf)):
        for sign, most in ((-1.0, 1.0), (1.0, LIGHTEST)):

            def radius(size: float, link: float = link, sign: float = sign) -> float:
                return _radius(pairs, [link], np.array([[sign * size]]), of_springs)

            low = 0.0
            for high in np.linspace(0.0, min(most, best.size), 25)[1:].tolist():
                if radius(high) >= 1.0:
                    size = _bisected(radius, low, high)
                    best = UnstableError(sign * size, (link,), 0.0, radius(size))
                    break
                low = high
    return _mixed(pairs, best, of_springs) if mixed else best


def _radius(pairs: SampledPairs, links: list[float], error: np.ndarray, of_springs: bool) -> float:
    return pairs.radius(links, 0.0 * error, error) if of_springs else pairs.radius(links, error)


def _mixed(pairs: SampledPairs, best: UnstableError, of_springs: bool) -> UnstableError:
    """The smallest error of two pairs, if it is smaller than the best so far."""
    from scipy.optimize import minimize

    low, high = np.log(pairs.gains.ends)
    places = [
        np.array([x, y, turn])
        for x, y in combinations_with_replacement(np.linspace(low, high, LINKS).tolist(), 2)
        for turn in (np.arange(TURNS) * np.pi / TURNS).tolist()
    ]

    def links(place: Vector) -> list[float]:
        return np.exp(np.clip(place[:2], low, high)).tolist()

    def radius(place: Vector, size: float) -> float:
        cosine, sine = np.cos(2.0 * place[2]), np.sin(2.0 * place[2])
        error = size * np.array([[cosine, sine], [sine, -cosine]])
        return _radius(pairs, links(place), error, of_springs)

    while True:
        size = 0.99 * min(best.size, 1.0)

        def stable(place: Vector, size: float = size) -> float:
            return -radius(place, size)

        starts = sorted(places, key=stable)[:CLIMBED]
        ends = [minimize(stable, start, method="Nelder-Mead", options=CLIMB) for start in starts]
        place: Vector = ends[int(np.argmin([float(end.fun) for end in ends]))].x
        if stable(place) > -1.0:
            return best

        def at_place(size: float, place: Vector = place) -> float:
            return radius(place, size)

        size = _bisected(at_place, 0.0, size)
        best = UnstableError(size, tuple(links(place)), float(place[2]), radius(place, size))


def _bisected(radius: Callable[[float], float], low: float, high: float) -> float:
    """An unstable size, between a stable and an unstable one."""
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if radius(middle) < 1.0 else (low, middle)
    return high
