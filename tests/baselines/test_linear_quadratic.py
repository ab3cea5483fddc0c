"""LQR against python-control and against the H∞ synthesis with γ = ∞."""

import numpy as np
import pytest
from tests.baselines.conftest import by_name
from tests.refusals import refused_with

from flexhinf.baselines import LinearQuadratic, lqr, lqr_gain
from flexhinf.errors import InvalidInput, NumericalFailure
from flexhinf.hinf import linear_law
from flexhinf.plant import Penalty, Plant

ROBOTS = ["paper", "quanser", "rig", "planar-two-link", "spatial-three-link", "seven-link"]


def linear_part(problem):
    """A, B with the integrals, by hand; and H of a penalty that is weights by name."""
    plant, k = problem.plant, len(problem.integrate)
    a, b, _, _ = plant.linearise(problem.operating_point[: plant.n], problem.operating_input)
    a, b = np.pad(a, ((0, k), (0, k))), np.pad(b, ((0, k), (0, 0)))
    for row, name in enumerate(problem.integrate):
        a[plant.n + row, plant.index(name)] = 1.0
    return a, b, np.diag([float(problem.penalty.states.get(name, 0.0)) for name in problem.state_names])


@pytest.mark.oracle
@pytest.mark.parametrize("name", ROBOTS)
def test_the_gain_is_python_controls(name):
    problem = by_name(name).problem()
    a, b, h = linear_part(problem)
    import control

    expected, _, poles = control.lqr(a, b, h @ h, 3.0 * problem.r2)
    law = lqr(problem, effort=3.0)
    np.testing.assert_allclose(law.gain, -expected, rtol=1e-6, atol=1e-7 * np.abs(expected).max())
    found = np.linalg.eigvals(law.closed_loop())
    np.testing.assert_allclose(np.sort(found.real), np.sort(poles.real), rtol=1e-5)


@pytest.mark.oracle
@pytest.mark.parametrize("name", ROBOTS)
def test_the_gain_is_that_of_the_game_without_an_opponent(name):
    problem = by_name(name).problem()
    game = linear_law(problem, gamma=np.inf)
    np.testing.assert_allclose(
        lqr(problem).gain, game.law(np.eye(len(problem.state_names))).T, rtol=1e-9,
        atol=1e-10 * np.abs(lqr(problem).gain).max(),
    )  # fmt: skip


def test_any_plant_will_do_and_more_effort_asked_for_is_less_input():
    plant = Plant(
        lambda x, u, d, p: np.array([x[1], u[0] + d[0]]), lambda x, u, p: x[:1], ("a", "b"), ("u",), ("d",)
    )
    problem = plant.with_objective(Penalty([1.0, 0.0], effort=1.0))
    np.testing.assert_allclose(lqr_gain(problem), [[-1.0, -np.sqrt(2.0)]], rtol=1e-12)
    np.testing.assert_allclose(lqr_gain(problem, 4.0), [[-0.5, -1.0]], rtol=1e-12)


def test_what_has_no_lqr_is_refused():
    robot = by_name("paper")
    with refused_with(NumericalFailure, "LQR", "'link_position_integral'"):
        lqr(robot.problem({"link_position": 1.0}))  # nothing sees the integral
    with refused_with(InvalidInput, "factor", "effort", 0.0):
        lqr(robot.problem(), effort=0.0)
    with refused_with(InvalidInput, "gain", "(1, 4)"):
        LinearQuadratic(plant=robot.plant(), equilibrium=robot.operating_point(), gain=np.zeros((1, 5)))
