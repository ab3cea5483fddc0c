"""The linear game of a search: the synthesis of the robot's problem, and norms of python-control."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest

import flexhinf as fh
from flexhinf.analysis.modes import JointScales
from flexhinf.designs.problem import weights
from flexhinf.designs.problem.weights import ROUGH, LinearFamily, LinearProblem
from flexhinf.hinf.linear_part import linear_smallest_gamma

pytest.importorskip("slycot", reason="missing: slycot, which has no wheel for every machine")
pytestmark = pytest.mark.oracle


def _game(robot: Any, pace: float, damping: float, torques: bool) -> tuple[LinearProblem, Any]:
    goal = np.array(robot.home)
    scales = JointScales.of(robot.plant(), robot.operating_point(goal))
    paces = np.full(len(goal), pace * scales.antiresonance)
    enter = np.eye(2 * len(goal)) if torques else None
    game = LinearProblem.of(LinearFamily.of(robot, goal, 0), scales.rows(paces, damping), not torques, enter)
    which = {"disturbances": ("link_torque", "motor_torque"), "command": None} if torques else {}
    return game, robot.problem(scales.penalty(paces, damping), pose=goal, **which)


@pytest.mark.quick_cases(3)
@pytest.mark.parametrize("torques", [False, True])
@pytest.mark.parametrize("name", ["paper", "cart", "planar-two-link"])
def test_it_is_the_linear_part_of_the_robots_problem(
    robot_of: Callable[[str], Any], name: str, torques: bool
) -> None:
    game, problem = _game(robot_of(name), 0.5, 0.3, torques)
    star = fh.smallest_gamma(problem)
    assert game.gamma_star == pytest.approx(star, rel=2 * ROUGH)
    solution = fh.solve_hji(problem, gamma=1.5 * star, degree=2)
    design = game.design(1.5 * star)
    assert design.gain == pytest.approx(solution.gain, rel=1e-6, abs=1e-9 * np.abs(solution.gain).max())
    assert pytest.approx(solution.P, rel=1e-6, abs=1e-9 * np.abs(solution.P).max()) == design.P


def test_its_smallest_level_is_bisected_once(
    robot_of: Callable[[str], Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    game, _ = _game(robot_of("paper"), 0.5, 0.3, False)
    bisected = Mock(wraps=weights.linear_smallest_gamma)
    monkeypatch.setattr(weights, "linear_smallest_gamma", bisected)
    first = game.gamma_star
    assert game.gamma_star == first == linear_smallest_gamma(game.linear_part(), ROUGH)
    assert bisected.call_count == 1


@pytest.mark.parametrize("name", ["paper", "quanser-rotflex", "cart", "planar-two-link"])
def test_what_a_gain_attains_is_the_norm_of_its_loop(robot_of: Callable[[str], Any], name: str) -> None:
    import control

    game, _ = _game(robot_of(name), 0.5, 0.3, False)
    star = game.gamma_star
    gains = [game.design(ratio * star).gain for ratio in (1.05, 1.5, 1e3)]
    attained = [game.attained(gain) for gain in gains]
    for gain, ratio, level in zip(gains, (1.05, 1.5, 1e3), attained):
        z = np.vstack([game.c, gain])
        loop = control.ss(game.a + game.b2 @ gain, game.b1, z, np.zeros((len(z), game.b1.shape[1])))
        assert level == pytest.approx(control.linfnorm(loop)[0], rel=2 * ROUGH)
        assert star * (1.0 - 2 * ROUGH) <= level <= ratio * star * (1.0 + 2 * ROUGH)
    assert attained == sorted(attained)


def test_another_price_of_the_input_is_a_change_of_its_units(robot_of: Callable[[str], Any]) -> None:
    """R2 = r is R2 = 1 for the input √r u."""
    game, _ = _game(robot_of("planar-two-link"), 0.5, 0.3, False)
    r = np.array([[200.0, 50.0], [50.0, 300.0]])
    root = np.linalg.cholesky(r).T  # |root u|² = uᵀ r u
    priced = LinearProblem(game.a, game.b1, game.b2, game.c, r)
    other = LinearProblem(game.a, game.b1, game.b2 @ np.linalg.inv(root), game.c, np.eye(2))
    star = other.gamma_star
    assert priced.gamma_star == pytest.approx(star, rel=2 * ROUGH)
    gain = other.design(1.5 * star).gain
    assert root @ priced.design(1.5 * star).gain == pytest.approx(gain, rel=1e-6, abs=1e-9)
    assert priced.attained(np.linalg.solve(root, gain)) == pytest.approx(other.attained(gain), rel=2 * ROUGH)
