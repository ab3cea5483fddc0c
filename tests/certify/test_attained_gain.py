"""The worst disturbance that ascent finds never exceeds a proved gain, and comes close to it, so that this could fail.

The loop is that of the theorem: the certificate's own terms, the true state, no sampling; x(0) = 0.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import cache
from typing import Any

import casadi
import numpy as np
import pytest
from tests.builders import runge_kutta
from tests.certify.definition import in_doubles, in_symbols
from tests.certify.test_checked_arm import proved_for_all_tolerances
from tests.tiers import ci_and_night

import flexhinf as fh
from flexhinf.certify import Certificate
from flexhinf.certify.box import parameter_groups

ARM = fh.paper_arm()
WEIGHTS = (75.0, 27.0, 90.0, 27.0, 330.0)
CHANNELS = ("link_torque", "motor_torque")
PERIOD, LENGTH = 5e-3, 6.0  # s: the disturbance is constant for a period, and runs end after the length


@dataclass(frozen=True)
class Attained:
    """A disturbance (w, N), its gain, and the largest V on its run over the level."""

    disturbance: np.ndarray
    gain: float
    largest: float


class Runs:
    """Runs of one certificate's loop from rest, with ∫|z|² and its gradient by the disturbance."""

    def __init__(self, claim: Certificate, length: float = LENGTH) -> None:
        self.claim, self.count = claim, round(length / PERIOD)
        self.n, self.w = len(claim.states), len(claim.disturbances)
        d = casadi.MX.sym("d", self.w, self.count)
        p = casadi.MX.sym("p", len(claim.parameters))
        runs = [self._run(d, p, steps) for steps in (1, 2)]
        cost = runs[0][self.n, -1]
        self._ascent = casadi.Function("ascent", [d, p], [cost, casadi.gradient(cost, d), runs[0]])
        self._finer = casadi.Function("finer", [d, p], [runs[1]])

    def _run(self, d: Any, p: Any, steps: int) -> Any:
        """x and ∫|z|², (n + 1, N), by Runge and Kutta's formula."""
        s, push, numbers = (
            casadi.SX.sym(name, k) for name, k in (("s", self.n + 1), ("d", self.w), ("p", p.numel()))
        )

        def rates(state: Any) -> Any:
            at = in_symbols(self.claim, state[: self.n], numbers)
            u = at.law()
            rows = zip(at.rates(u), at.disturbance_matrix(), strict=True)
            moved = [f + sum(g * push[j] for j, g in enumerate(row)) for f, row in rows]
            return casadi.vertcat(*moved, at.squared_output(u))

        state = s
        for _ in range(steps):
            state = runge_kutta(rates, state, PERIOD / steps)
        step = casadi.Function("step", [s, push, numbers], [state])
        return step.mapaccum(self.count)(casadi.MX.zeros(self.n + 1), d, casadi.repmat(p, 1, self.count))

    def climb(self, parameters: np.ndarray, energy: float, start: np.ndarray, turns: int) -> Attained:
        """Ascent on ∫|z|²/∫|d|²: the disturbance is replaced by the gradient, of the same energy."""
        d, best = start, (0.0, start)
        for _ in range(turns):
            d = d * np.sqrt(energy / (PERIOD * (d**2).sum()))
            cost, slope, _ = self._ascent(d, parameters)
            best = max(best, (float(cost) / energy, d), key=lambda pair: pair[0])
            d = np.array(slope)
        run = np.array(self._finer(best[1], parameters))
        gain = float(np.sqrt(run[self.n, -1] / energy))
        assert gain == pytest.approx(
            np.sqrt(best[0]), rel=1e-4
        )  # what is attained is the loop's, not the step's
        value = in_doubles(self.claim, run[: self.n].T, np.zeros((1, parameters.size))).value()
        return Attained(best[1], gain, float(value.max() / self.claim.level))

    def starts(self, count: int, seed: int = 0) -> list[np.ndarray]:
        """Fading random walks."""
        rng, fade = np.random.default_rng(seed), np.exp(-PERIOD * np.arange(self.count))
        return [np.cumsum(rng.standard_normal((self.w, self.count)), axis=1) * fade for _ in range(count)]


def check_gain(claim: Certificate, parameters: np.ndarray, share: float, *, starts: int, turns: int) -> Runs:
    """For energies from small ones to where V comes near the level: never beyond γ, and `share` · γ is attained."""
    runs = Runs(claim)
    most, attained = 2.0 * claim.level / claim.gamma**2, []
    for start, energy in itertools.product(runs.starts(starts), (0.01 * most, most, 3.0 * most, 9.0 * most)):
        found = runs.climb(parameters, energy, start, turns)
        assert found.largest <= 1.0 or energy > most  # the theorem's bound of V
        if found.largest <= 1.0:
            assert found.gain <= claim.gamma
            attained.append(found)
    assert len(attained) >= 2 * starts
    assert max(a.gain for a in attained) >= share * claim.gamma
    assert max(a.largest for a in attained) > 0.1  # not only small motions
    return runs


@cache
def tight(goal: int, degree: int, channels: tuple[str, ...], level: float | None = None) -> Certificate:
    """Proved with γ 6 % above the smallest that any law has for small motions."""
    to: Any = {"disturbances": channels} if channels else {"command": "disturbance"}
    problem = ARM.plant().with_objective(
        fh.Penalty(WEIGHTS, effort=10.0), integrate=("link_position",), pose=(np.radians(goal),), **to
    )
    star = fh.smallest_gamma(problem)
    solution = fh.solve_hji(problem, gamma=1.05 * star, degree=degree)
    return solution.certify(gamma=1.06 * star, penalty=tuple(0.98 * v for v in WEIGHTS), level=level)


def middle(claim: Certificate) -> np.ndarray:
    return np.array([p.middle for p in claim.parameters])


@pytest.mark.ci("ascends on a gradient; the budget along runs is quick")
def test_a_proved_gain_is_nearly_attained_and_never_exceeded() -> None:
    claim = tight(90, 2, CHANNELS, 33.0)
    check_gain(claim, middle(claim), 0.96, starts=1, turns=4)


@pytest.mark.parametrize(
    ("goal", "degree", "channels", "share"),
    ci_and_night("three starts at four energies", [(180, 4, (), 0.96)], [(90, 4, CHANNELS, 0.97)]),
)
def test_proved_gains_of_nonlinear_laws(
    goal: int, degree: int, channels: tuple[str, ...], share: float
) -> None:
    claim = tight(goal, degree, channels)
    check_gain(claim, middle(claim), share, starts=3, turns=12)


@pytest.mark.parametrize("apart", ci_and_night("ascends at corners of the box", [9], [1]))
def test_no_robot_of_the_box_exceeds_the_gain_that_is_proved_for_all(apart: int) -> None:
    """90°: corners of the box in short, the worst of them and robots inside at length."""
    claim = proved_for_all_tolerances()
    runs, energy = Runs(claim), 2.0 * claim.level / claim.gamma**2
    found = [runs.climb(corner, energy, runs.starts(1)[0], 4) for corner in corners(claim)[::apart]]
    assert len(corners(claim)) == 128
    assert max(a.gain for a in found) <= claim.gamma
    assert max(a.largest for a in found) <= 1.0
    worst = corners(claim)[apart * int(np.argmax([a.gain for a in found]))]
    check_gain(claim, worst, 0.6, starts=2, turns=20)
    low, high = np.array([(p.low, p.high) for p in claim.parameters]).T
    for inside in np.random.default_rng(2).uniform(low, high, (8, len(low))):
        assert runs.climb(inside, energy, runs.starts(1)[0], 8).gain <= claim.gamma


def corners(claim: Certificate) -> list[np.ndarray]:
    """Of the box, products of parameters being one variable each."""
    ends = {p.name: (p.low, p.high) for p in claim.parameters}
    groups, result = parameter_groups(claim), []
    for sides in itertools.product((0, 1), repeat=len(groups)):
        at = dict(zip(ends, middle(claim).tolist(), strict=True))
        for group, side in zip(groups, sides, strict=True):
            at |= {name: ends[name][side if power > 0 else 1 - side] for name, power in group.items()}
        result.append(np.array(list(at.values())))
    return result
