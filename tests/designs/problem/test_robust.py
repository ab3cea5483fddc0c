"""The claim of robust: for every |Δ| ≤ 1 the loop is stable and attains its level; a nominal gain does not."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from flexhinf.analysis.modes import JointScales
from flexhinf.designs.problem.presets import channels
from flexhinf.designs.problem.weights import (
    MIN_FRACTION,
    LinearFamily,
    LinearProblem,
    RobustProblem,
    UncertaintyChannel,
    find_scalings,
)
from flexhinf.errors import NoFeasibleGamma
from flexhinf.hinf import HJISolution

pytest.importorskip("slycot", reason="missing: slycot, which has no wheel for every machine")
pytestmark = pytest.mark.oracle

RATIO = 1.5


@dataclass(frozen=True, eq=False)
class Case:
    """A robust design, and the nominal one of the same penalty."""

    family: LinearFamily
    game: RobustProblem
    gamma: float
    robust: HJISolution
    nominal: HJISolution

    @property
    def channels(self) -> tuple[UncertaintyChannel, ...]:
        return self.game.channels

    def loop(self, gain: np.ndarray, deltas: np.ndarray, share: float | None = None) -> np.ndarray:
        """A + B K + Σ Δ t (c + e K), of a share of the tolerances."""
        g, share = self.game.nominal, self.game.fraction if share is None else share
        a = g.a + g.b2 @ gain
        for delta, channel in zip(deltas, self.channels):
            seen = np.append(channel.by_state, np.zeros(len(a) - len(channel.by_state)))
            enters = self.game.torques @ channel.torque
            a = a + share * delta * np.outer(enters, seen + channel.by_input @ gain)
        return a

    def norm(self, gain: np.ndarray, a: np.ndarray) -> float:
        """H∞ norm of d → z of python-control; infinite for a loop that is not stable."""
        if np.linalg.eigvals(a).real.max() >= 0.0:
            return np.inf
        import control

        g = self.game.nominal
        z = np.vstack([g.c, np.linalg.cholesky(g.r2).T @ gain])
        return control.linfnorm(control.ss(a, g.b1, z, np.zeros((len(z), g.b1.shape[1]))))[0]

    def worst(self, gain: np.ndarray, rng: np.random.Generator, starts: int) -> float:
        """The largest norm found by turning one sign after the other until none makes it larger."""
        largest = 0.0
        for _ in range(starts):
            signs = rng.choice([-1.0, 1.0], len(self.channels))
            value, better = self.norm(gain, self.loop(gain, signs)), True
            while better and np.isfinite(value):
                better = False
                for k in range(len(signs)):
                    signs[k] *= -1.0
                    other = self.norm(gain, self.loop(gain, signs))
                    if other > value:
                        value, better = other, True
                    else:
                        signs[k] *= -1.0
            largest = max(largest, value)
        return largest


def _wider(robot: Any, factor: float) -> Any:
    wide = [replace(p, tolerance=min(80.0, factor * p.tolerance)) for p in robot.parameters]
    return replace(robot, parameters=tuple(wide))


def _case(robot: Any, frequency: float, damping_weight: float, torques: bool = False) -> Case:
    goal = np.array(robot.home)
    family, scales = LinearFamily.of(robot, goal), JointScales.of(robot.plant(), robot.operating_point(goal))
    rows = scales.rows(np.full(len(goal), frequency * scales.antiresonance), damping_weight)
    nominal = LinearProblem.of(family, rows, not torques, np.eye(2 * len(goal)) if torques else None)
    game = find_scalings(nominal, family.torques, channels(robot, [goal]), RATIO)
    star = game.smallest_gamma(1e-6)
    design = game.design(RATIO * star)
    lowest = nominal.gamma_star
    return Case(family, game, RATIO * star, design, nominal.design(RATIO * lowest))


#: Robot, factor of its tolerances, target frequency over the lowest vibration, damping weight, whether torques disturb.
CASES = {
    "paper": ("paper", 1.0, 0.45, 0.1, False),
    "paper, fast and three times as uncertain": ("paper", 3.0, 2.0, 0.0, False),
    "paper, torques": ("paper", 1.0, 0.45, 0.1, True),
    "soft": ("paper stiffness*0.3 motor_inertia*2", 2.0, 0.6, 0.0, False),
    "quanser": ("quanser-rotflex", 1.0, 2.0, 0.0, False),
    "quanser, twice as uncertain": ("quanser-rotflex", 2.0, 0.7, 0.0, False),
    "cart": ("cart", 1.0, 0.6, 0.1, False),
    "two links, fast and twice as uncertain": ("planar-two-link", 2.0, 1.5, 0.0, False),
    "seven links": ("seven-link", 1.0, 0.65, 0.0, False),
}
NOMINAL_FAILS = (
    "paper, fast and three times as uncertain",
    "quanser",
    "two links, fast and twice as uncertain",
)
PART_ONLY = ("quanser, twice as uncertain", "seven links")


@pytest.fixture(scope="module")
def case_of(robot_of: Callable[[str], Any]) -> Callable[[str], Case]:
    known: dict[str, Case] = {}

    def named(name: str) -> Case:
        if name not in known:
            base, wide, frequency, weight, torques = CASES[name]
            known[name] = _case(_wider(robot_of(base), wide), frequency, weight, torques)
        return known[name]

    return named


def _drawn(rng: np.random.Generator, count: int, channels: int) -> Iterator[np.ndarray]:
    for k in range(count):
        yield rng.choice([-1.0, 1.0], channels) if k % 2 else rng.uniform(-1.0, 1.0, channels)


@pytest.mark.quick_cases(2)
@pytest.mark.parametrize("name", CASES)
def test_every_robot_of_the_channels_is_stable_and_attains_the_level(
    case_of: Callable[[str], Case], name: str
) -> None:
    case, rng = case_of(name), np.random.default_rng(11)
    gain = case.robust.gain
    norms = [
        case.norm(gain, case.loop(gain, deltas))
        for deltas in _drawn(rng, 30 if len(case.channels) < 60 else 8, len(case.channels))
    ]
    assert max(norms) <= case.gamma * (1.0 + 1e-9)
    if len(case.channels) < 60:
        assert case.worst(gain, rng, 2) <= case.gamma * (1.0 + 1e-9)


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize("name", NOMINAL_FAILS)
def test_the_gain_made_without_channels_exceeds_that_level_somewhere(
    case_of: Callable[[str], Case], name: str
) -> None:
    case = case_of(name)
    gain, nothing = case.nominal.gain, np.zeros(len(case.channels))
    assert case.norm(gain, case.loop(gain, nothing)) <= RATIO * case.game.nominal.gamma_star < case.gamma
    assert case.worst(gain, np.random.default_rng(3), 4) > case.gamma


@pytest.mark.quick_cases(4)
@pytest.mark.parametrize("name", [name for name in CASES if name not in PART_ONLY])
def test_the_robots_corners_themselves_attain_the_level(case_of: Callable[[str], Case], name: str) -> None:
    """A(p), B(p) of the family, all parameters at their ends at once; the channels cover them but for products."""
    case = case_of(name)
    assert case.game.fraction == 1.0
    gain = case.robust.gain
    for a, b in zip(case.family.a, case.family.b):
        assert case.norm(gain, a + b @ gain) <= case.gamma * (1.0 + 1e-9)


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize("name", PART_ONLY)
def test_where_the_whole_tolerances_are_too_much_a_part_is_covered_and_told(
    case_of: Callable[[str], Case], name: str
) -> None:
    case = case_of(name)
    share = case.game.fraction
    assert MIN_FRACTION <= share < 1.0
    highest = 1e4 * case.game.nominal.gamma_star
    assert case.game.feasible(highest)
    assert not replace(case.game, fraction=1.0).feasible(highest)
    assert not replace(case.game, fraction=share / 0.9 + 0.021).feasible(highest)


@pytest.mark.parametrize(
    "name", ["paper", "cart", pytest.param("seven links", marks=pytest.mark.ci("100 channels"))]
)
def test_gamma_star_is_the_edge_of_what_has_a_solution(case_of: Callable[[str], Case], name: str) -> None:
    case = case_of(name)
    star = case.gamma / RATIO
    assert case.game.feasible(1.0001 * star)
    assert not case.game.feasible(0.999 * star)
    assert star > case.game.nominal.gamma_star


@pytest.mark.parametrize(
    "name", ["paper", "two links, fast and twice as uncertain", "quanser, twice as uncertain"]
)
def test_the_channels_together_are_the_sum_of_each(case_of: Callable[[str], Case], name: str) -> None:
    case = case_of(name)
    rng = np.random.default_rng(0)
    scaled = replace(case.game, log=rng.normal(size=len(case.channels)), fraction=0.37)
    enter, seen, price = scaled.parts
    n, m = len(case.game.nominal.a), case.game.nominal.b2.shape[1]
    wanted = [np.zeros((len(enter), len(enter))), np.zeros((n, n)), np.zeros((m, m))]
    for channel, log in zip(case.channels, scaled.log):
        s, root = np.exp(log), np.sqrt(0.37)
        g = root * channel.torque / s
        z = root * s * np.append(channel.by_state, np.zeros(n - len(channel.by_state)))
        e = root * s * channel.by_input
        for total, v in zip(wanted, (g, z, e)):
            total += np.outer(v, v)
    assert enter @ enter.T == pytest.approx(wanted[0], rel=1e-9, abs=1e-9 * np.abs(wanted[0]).max())
    assert seen.T @ seen == pytest.approx(wanted[1], rel=1e-9, abs=1e-9 * np.abs(wanted[1]).max())
    assert price == pytest.approx(wanted[2], rel=1e-9, abs=1e-12)


@pytest.mark.parametrize("name", ["paper", "cart"])
def test_the_scalings_cannot_be_bettered_by_a_factor_for_a_quantity(
    case_of: Callable[[str], Case], name: str
) -> None:
    case = case_of(name)
    groups = [channel.group for channel in case.channels]
    star = case.gamma / RATIO
    assert not replace(case.game, log=np.zeros(len(groups)), fraction=1.0).feasible(
        100.0 * star
    )  # s = 1 would not do
    for group in dict.fromkeys(groups):
        here = np.array([g == group for g in groups])
        for factor in (0.7, 1.4):
            moved = replace(case.game, log=case.game.log + np.log(factor) * here)
            assert moved.gamma_star > 0.99 * star


def test_tolerances_that_no_gain_bears_are_refused(case_of: Callable[[str], Case]) -> None:
    case = case_of("paper")
    huge = tuple(replace(c, torque=300.0 * c.torque) for c in case.channels)
    game = replace(case.game, channels=huge, log=np.zeros(len(huge)))
    with pytest.raises(NoFeasibleGamma, match="part"):
        find_scalings(game.nominal, game.torques, huge, RATIO)
    with pytest.raises(NoFeasibleGamma, match="whole"):
        _ = game.gamma_star
