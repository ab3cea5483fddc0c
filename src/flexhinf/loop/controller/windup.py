"""How far integrals may push an input that has no limit of its own.

A sensor that sticks is an error that never ends: without a bound, its integral asks for any input. With limits of the
input the anti-windup of the step is the bound; without, this one is. What the integrals push is c = K_e (e − e*), with
the law's slope K at its operating point. At rest at a command r the law needs c = G (r − r*), G = ∂u/∂r − K ∂x/∂r, on
the line of equilibria x(r), u(r) of the model through the operating point; a nonlinear law, gravity, loads and errors
of the model need something more or less. So an integral that would push c further from G (r − r*) than

    w + S |r − r*|,  w = Σᵢ sᵢ (|∂u/∂rᵢ| + ½ |K ∂x/∂rᵢ|),  S = ½ |G|,

stands still, with the travel sᵢ of the tracked state i: w is what holds the robot over its travel, and what the law
answers to an error of half of it. The input itself is not limited.

A law of no known model has no such line: there G = 0, and w and S have Σⱼ |Kⱼ| of all states in place of the slopes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from flexhinf.errors import InvalidInput
from flexhinf.loop.controller.law_code import LawCode
from flexhinf.plant import Estimator, Law, Plant, ProblemLaw
from flexhinf.untrusted import value_text

#: Travel of a tracked state without a range, in its unit: half a turn, or m.
TRAVEL = np.pi

#: How much of the law's answer is spare, on both sides.
SPARE = 0.5


@dataclass(frozen=True, eq=False)
class Windup:
    """The bound of what integrals push, for L laws of m inputs and k integrals.

    Attributes
    ----------
    limit : (m,) array
        w; infinite for inputs with limits of their own.
    line, spread : (L, m, k) arrays
        G and S; (m, k) of one law.
    """

    limit: np.ndarray
    line: np.ndarray
    spread: np.ndarray

    def check(self, laws: Sequence[Law]) -> None:
        """Refuse numbers of a file that do not fit these laws.

        Raises
        ------
        InvalidInput
            If shapes differ, or a number is NaN or, but for limits, infinite.
        """
        size = (len(laws[0].input_names), len(laws[0].tracked))
        shape = size if len(laws) == 1 else (len(laws), *size)
        fits = [np.shape(part) for part in (self.limit, self.line, self.spread)] == [size[:1], shape, shape]
        if not fits or not np.all(self.limit >= 0.0) or not np.isfinite([self.line, self.spread]).all():
            raise InvalidInput(
                "The bound of the integrals does not fit the law.",
                f"expected numbers for {size[0]} inputs and {size[1]} integrals, got {value_text(vars(self))}",
                "windup=None: the bound of law and model",
            )

    @staticmethod
    def of(laws: Sequence[Law], estimator: Estimator | None, ends: Any) -> Windup:
        """The default for these laws; `ends` are the lower and the upper limits of the inputs, (m,) each."""
        limited = np.isfinite(np.asarray(ends)).all(axis=0)
        found = [_bounds(law, estimator) for law in laws]
        limit = np.max([limit for limit, _, _ in found], axis=0)
        lines, spreads = (
            np.stack([one[part] for one in found]) if len(found) > 1 else found[0][part] for part in (1, 2)
        )
        return Windup(np.where(limited, np.inf, limit), lines, spreads)

    @property
    def text(self) -> str:
        """The bound at the operating point, in words."""
        sizes = self.limit[np.isfinite(self.limit)]
        return ", ".join(f"at most {size:.4g} more than at rest" for size in sizes)


def _bounds(law: Law, estimator: Estimator | None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """w, G and S of one law."""
    names = law.plant_states
    n, places = len(names), [names.index(name) for name in law.tracked]
    point, rest = (np.asarray(part, dtype=float) for part in (law.operating_point, law.operating_input))
    slope = LawCode(law, False).slope[:, :n]
    model: Plant | None = estimator.plant if estimator is not None else None
    if model is None and isinstance(law, ProblemLaw):
        model = law.problem.plant
    travel = TRAVEL + np.abs(point[places])
    if model is None:
        size = np.repeat(np.abs(slope).sum(axis=1, keepdims=True), len(places), axis=1)
        return size @ travel, np.zeros_like(size), size
    for k, place in enumerate(places):
        ends = np.array(model.limits.get(names[place], (-np.inf, np.inf)), dtype=float)
        travel[k] = min(travel[k], np.abs(ends - point[place]).max())
    along, held = _line(model, point[:n], rest, places)
    reaction = slope @ along
    line = held - reaction
    return (np.abs(held) + SPARE * np.abs(reaction)) @ travel, line, SPARE * np.abs(line)


def _line(model: Plant, x: np.ndarray, u: np.ndarray, places: list[int]) -> tuple[np.ndarray, np.ndarray]:
    """∂x/∂r (n, k) and ∂u/∂r (m, k) of the equilibria through one, r the states at `places`."""
    a, b, _, _ = model.linearise(x, u)
    chosen = np.eye(len(x))[places]
    rows = np.block([[a, b], [chosen, np.zeros((len(places), len(u)))]])
    line = np.linalg.lstsq(rows, np.eye(len(rows))[:, len(x) :], rcond=None)[0]
    return line[: len(x)], line[len(x) :]
