"""The worst plant of a box with its worst disturbance: against the H-infinity norm on a grid, and the other frame."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import flexhinf as fh
from flexhinf.analysis import worst_disturbance
from flexhinf.analysis.worst_disturbance import MovedLaw, worst_gain
from flexhinf.plant import GeneralisedPlant

LOW, HIGH = np.array([15.0, 0.8]), np.array([25.0, 1.2])


def flow(x, u, d, p):
    return np.array([x[1], (u[0] + d[0] - p.stiffness * x[0] - 0.5 * x[1] - p.weight) / p.mass])


def output(x, u, p):
    return np.array([x[0]])


@pytest.fixture(scope="module")
def problem():
    plant = fh.Plant(
        flow, output, states=("position", "velocity"), inputs=("force",), disturbances=("push",),
        parameters={"mass": 1.0, "stiffness": 20.0, "weight": 2.0},
    )  # fmt: skip
    penalty = {"position": 10.0, "velocity": 1.0, "position_integral": 5.0}
    return plant.with_objective(fh.Penalty(penalty), integrate=("position",), pose=[0.1])


@pytest.fixture(scope="module")
def law(problem):
    return fh.solve_hji(problem, gamma=1.5 * fh.smallest_gamma(problem), degree=2)


def at(problem):
    def problem_at(point):
        stiffness, mass = (1.0 - point) * LOW + point * HIGH
        plant = problem.plant.with_parameters(stiffness=stiffness, mass=mass)
        return replace(problem, plant=plant)

    return problem_at


def norm(problem: GeneralisedPlant, gain: np.ndarray) -> float:
    """H-infinity norm of the continuous loop from d to z, by a sweep."""
    p = problem.plant.parameters
    values = p.named(p.vector())
    a = np.array([[0, 1, 0], [-values.stiffness / values.mass, -0.5 / values.mass, 0], [1, 0, 0]])
    b = np.array([[0.0], [1.0 / values.mass], [0.0]])
    c = np.vstack([np.diag([10.0, 1.0, 5.0]), np.sqrt(problem.r2) * gain])
    sweep = np.geomspace(0.1, 100.0, 400)
    return max(
        float(np.linalg.norm(c @ np.linalg.solve(1j * w * np.eye(3) - a - b @ gain, b))) for w in sweep
    )


@pytest.mark.nightly("eight ascents at corners; tests/certify/test_attained_gain.py has others")
@pytest.mark.oracle
def test_the_gain_is_the_largest_norm_of_a_grid_over_the_box(problem, law):
    """The weight bends every equilibrium away from the nominal one; the loop is linear about each of them."""
    first = worst_disturbance(problem, law, level=0.01, horizon=12.0, period=5e-3, turns=8)
    found = worst_gain(
        at(problem), law, np.array([0.5, 0.5]), first, level=0.01, period=5e-3, horizon=12.0
    )  # fmt: skip
    grid = [np.array([a, b]) for a in np.linspace(0, 1, 5) for b in np.linspace(0, 1, 5)]
    norms = [norm(at(problem)(point), law.gain) for point in grid]
    assert max(norms) > 1.02 * norm(problem, law.gain)
    assert found.attained.gain > first.gain
    assert found.attained.gain <= 1.005 * max(norms)  # held inputs; a lower bound
    assert found.attained.gain >= 0.95 * max(norms)
    assert found.point == pytest.approx(grid[int(np.argmax(norms))], abs=1e-9)
    assert found.attained.largest_value <= 0.01


def test_a_moved_law_is_the_law_about_the_other_equilibrium(problem):
    law = fh.solve_hji(problem, gamma=1.5 * fh.smallest_gamma(problem), degree=2)
    stiff = at(problem)(np.array([1.0, 1.0]))
    moved = MovedLaw(law, stiff)
    assert not np.any(moved.evaluate_law(np.zeros(3), moved.law_data))
    assert moved.operating_input[0] == pytest.approx(25.0 * 0.1 + 2.0)
    x = np.array([0.02, -0.3, 0.1])
    n = len(law.state_names)
    shift = moved.law_data[-n - 1 : -1]
    held = law.operating_input + law.evaluate_law(x + shift, law.law_data)  # what the nominal law says there
    assert moved.operating_input + moved.evaluate_law(x, moved.law_data) == pytest.approx(held, rel=1e-12)
    loop = fh.Loop(stiff.plant, fh.Controller(moved, None, 5e-3))
    run = loop.run(fh.Step(0.1), duration=0.5)
    np.testing.assert_allclose(run.signals["state"][-1], stiff.operating_point[:2], atol=1e-9)
