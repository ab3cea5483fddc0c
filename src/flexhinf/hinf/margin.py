"""The margin between the designed pair of γ and penalty and the weaker pair that is checked.

With the exact fields, u = −R2⁻¹ g2ᵀ V_xᵀ satisfies V̇ ≤ ½ γ²|d|² − ½ |z|² wherever

    r(x) = V_x f + ½ hᵀh + ½ V_x (g1 g1ᵀ/γ² − g2 R2⁻¹ g2ᵀ) V_xᵀ ≤ 0.

For the designed γ and h, r is a remainder of either sign. So a weaker pair is checked, a larger γ_c and a smaller
penalty h_c. Its quadratic part is then, by the Riccati equation, r_2 = −½ xᵀMx with the margin

    M = CᵀC − C_cᵀC_c + (1/γ² − 1/γ_c²) P B1 B1ᵀ P,    C = ∂h/∂x, C_c = ∂h_c/∂x.

Where M is positive definite, r < 0 near the operating point, and there is a largest level set of V on which nothing
fails. Where xᵀMx = 0 for some x ≠ 0, the remainder decides there, and it may be positive arbitrarily near 0: then no
region is claimed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from numbers import Real
from typing import Any, NamedTuple

import numpy as np

from flexhinf.errors import InvalidInput
from flexhinf.hinf.value_function import ValueFunction
from flexhinf.notebook import Summarised, number_text
from flexhinf.plant.penalty import Penalty
from flexhinf.validation import real_array

GAMMA_MARGIN = 1.1  # default: checked gamma over designed gamma
PENALTY_MARGIN = 0.9  # default: checked penalty over designed penalty

#: The margin is definite where its smallest rate exceeds this fraction of the fastest rate of V̇: rounding in M is far
#: below, and what is smaller could not be distinguished from a remainder.
DEFINITE = 1e-9

_DIFFERENCE = 1e-4  # deviation for the slope of a penalty function

#: h of a check: a `Penalty` with the R2 of the design, or the weights, the matrix or the function h(x) alone.
CheckedPenalty = (
    Penalty | Callable[[np.ndarray], np.ndarray] | Mapping[str, Any] | Sequence[float] | np.ndarray
)


class CheckedPair(NamedTuple):
    """The γ and penalty that are checked instead of the designed ones.

    `output`: The checked h from x (N, n) and the designed h (N, s). `text`: How the pair differs from the designed one.
    """

    gamma: float
    output: Callable[[np.ndarray, np.ndarray], np.ndarray]
    text: str


@dataclass(frozen=True, eq=False, repr=False)
class CheckedMargin(Summarised):
    """How much weaker the checked pair is than the designed one, near the operating point: r_2 = −½ xᵀMx.

    Attributes
    ----------
    gamma : float
        The checked attenuation level.
    text : str
        How the checked pair differs from the designed one.
    rate : float
        Smallest eigenvalue of M relative to P, 1/s: r_2 ≤ −`rate` V_2.
    fastest : float
        Largest rate of the terms of V̇ in the same sense, 1/s.
    direction : ndarray, shape (n,)
        Where the margin is smallest.
    """

    gamma: float
    text: str
    rate: float
    fastest: float
    direction: np.ndarray
    state_names: tuple[str, ...]

    @property
    def definite(self) -> bool:
        """Whether r_2 < 0 in every direction, by more than 1e-9 of the fastest rate."""
        return self.rate > DEFINITE * self.fastest

    @property
    def semidefinite(self) -> bool:
        """Whether r_2 ≤ 0 in every direction, up to 1e-9 of the fastest rate."""
        return self.rate >= -DEFINITE * self.fastest

    def reason(self) -> str:
        """Why there is a region, or none, in one sentence."""
        if self.definite:
            return f"the margin is definite: r <= -{self.rate:.3g}/s * V near the operating point"
        shares = np.abs(self.direction) / np.abs(self.direction).max()
        where = ", ".join(name for name, share in zip(self.state_names, shares, strict=True) if share > 0.1)
        if not self.semidefinite:
            return f"the checked pair is not weaker than the designed one (mainly in {where})"
        return f"no margin in some direction (mainly {where}), so the remainder decides arbitrarily near 0"

    def summary(self) -> dict[str, str]:
        """Rate, whether it is definite, and the checked pair, for ``repr``."""
        return {
            "definite": "yes" if self.definite else "no",
            "rate": number_text(self.rate, "1/s"),
            "fastest rate": number_text(self.fastest, "1/s"),
            "checked gamma": number_text(self.gamma),
            "checked pair": self.text,
        }


def checked_margin(
    solution: ValueFunction, gamma: float | None = None, penalty: CheckedPenalty | None = None
) -> CheckedMargin:
    """The margin M between the designed pair and the checked one; arguments as `HJISolution.sampled_region`."""
    pair = checked_pair(solution, gamma, penalty)
    plant, p = solution.expansion, solution.P
    steps = _DIFFERENCE * np.eye(len(p))  # h_c is a function: its slope is differenced
    plus, minus = (pair.output(x, x @ plant.h_parts[1].T) for x in (steps, -steps))
    checked_h = (plus - minus).T / (2 * _DIFFERENCE)
    b1, b2 = p @ plant.g1_parts[0][:, :, 0], p @ plant.g2_parts[0][:, :, 0]
    designed, attenuated = plant.h_parts[1].T @ plant.h_parts[1], b1 @ b1.T / solution.gamma**2
    margin = designed - checked_h.T @ checked_h + attenuated - b1 @ b1.T / pair.gamma**2
    terms = designed + attenuated + b2 @ np.linalg.solve(plant.r2, b2.T)
    values, vectors = np.linalg.eigh(p)
    root = vectors / np.sqrt(np.maximum(values, 1e-14 * values[-1]))
    rates, directions = np.linalg.eigh(root.T @ margin @ root)
    fastest = float(np.linalg.eigvalsh(root.T @ terms @ root)[-1])
    return CheckedMargin(
        pair.gamma, pair.text, float(rates[0]), fastest, root @ directions[:, 0], tuple(solution.state_names)
    )


def checked_pair(
    solution: ValueFunction, gamma: float | None = None, penalty: CheckedPenalty | None = None
) -> CheckedPair:
    """The checked γ and penalty; arguments as `HJISolution.sampled_region`."""
    checked = GAMMA_MARGIN * solution.gamma if gamma is None else gamma
    if not isinstance(checked, Real) or not checked >= solution.gamma:
        raise InvalidInput(
            "The check cannot be made with these numbers.",
            f"expected gamma ≥ the designed {solution.gamma:.6g}, got {checked!r}",
            "a weaker level than the designed one, for example 1.1 times it",
        )
    finite, designed = np.isfinite(solution.gamma), solution.expansion.r2
    level = f"{checked / solution.gamma:.4g} times the designed gamma" if finite else "gamma = inf"
    if isinstance(penalty, Penalty):  # the check is about the law, which was made with the designed R2
        if not np.allclose(penalty.r2(len(designed)), designed, rtol=1e-9, atol=0.0):
            raise InvalidInput(
                "The checked penalty has another R2 than the design.",
                f"expected {designed.tolist()}, got {penalty.r2(len(designed)).tolist()}",
                "Penalty(states, effort=…) with the R2 of the design, or its states alone: penalty.states",
            )
        if callable(penalty.states):
            raise InvalidInput(
                "A penalty of code has parameters that a solution does not know.",
                f"expected weights, a matrix, or a function of x alone, got {penalty.states!r}",
                "penalty=lambda x: … of deviations x (N, n)",
            )
        penalty = penalty.states
    if penalty is None:
        text = f"{level}, {PENALTY_MARGIN} times the designed penalty"
        return CheckedPair(float(checked), lambda x, h: PENALTY_MARGIN * h, text)
    if callable(penalty):
        return CheckedPair(float(checked), lambda x, h: penalty(x), f"{level}, a given penalty function")
    n, names = len(solution.P), solution.state_names
    if isinstance(penalty, Mapping):
        groups = {}  # link_position_elbow is one joint's of link_position, and so for integrals
        for group in [name for name in penalty if name not in names]:
            stem, integral = group.removesuffix("_integral"), group.endswith("_integral")
            members = [name for name in names if name.startswith(f"{stem}_")]
            if members := [name for name in members if name.endswith("_integral") == integral]:
                groups[group] = members
        penalty = Penalty(penalty).expanded(groups).states
        assert isinstance(penalty, Mapping)
        unknown = sorted(set(penalty) - set(names))
        if unknown:
            raise InvalidInput(
                "The penalty names a state that does not exist.",
                f"expected names among {', '.join(names)}, got {', '.join(unknown)}",
                "the names of the problem's states",
            )
        penalty = [penalty.get(name, 0.0) for name in names]
    weights = real_array(penalty)
    matrix: np.ndarray = np.diag(weights) if weights.ndim == 1 else weights
    if matrix.ndim != 2 or matrix.shape[1] != n or not np.isfinite(matrix).all():
        raise InvalidInput(
            "The penalty does not fit the states.",
            f"expected {n} finite weights or a matrix with {n} columns, got shape {weights.shape}: {penalty!r}",
            "one weight per state, or {name: weight}",
        )
    text = f"{level}, penalty weights {np.array2string(weights, precision=6)}"
    return CheckedPair(float(checked), lambda x, h: x @ matrix.T, text)
