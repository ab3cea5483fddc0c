"""What a closed loop runs is what the solution says: u = −R2⁻¹ g2(x)ᵀ V_xᵀ with the exact g2."""

import numpy as np
import pytest

import flexhinf as fh


def turned(x, u, d, p):
    """A pendulum whose input loses its grip as it turns."""
    return np.array([x[1] + d[0], -np.sin(x[0]) + np.cos(x[0]) * u[0]])


@pytest.fixture(scope="module")
def pendulum():
    return fh.Plant(turned, lambda x, u, p: x[:1], states=("a", "b"), inputs=("u",), disturbances=("d",))


@pytest.mark.parametrize("degree", [2, 4, 5])
def test_the_loop_applies_the_law_where_g2_depends_on_the_state(pendulum, degree):
    problem = pendulum.with_objective({"a": 1.0, "b": 1.0})
    solution = fh.solve_hji(problem, gamma=3 * fh.smallest_gamma(problem), degree=degree)
    assert not solution.law_is_polynomial
    for x in ([0.5, 0.0], [1.0, -0.3], [1.5, 0.2]):
        slope = solution.gradient(np.array(x))
        expected = -np.cos(x[0]) * slope[1] / problem.r2[0, 0]
        controller = fh.Controller(solution, None, 1e-2)
        np.testing.assert_allclose(solution.law(np.array(x)), [expected], rtol=1e-12)
        np.testing.assert_allclose(controller.step(x), [expected], rtol=1e-12)


def test_a_loaded_solution_without_its_plant_runs_what_it_says(pendulum, tmp_path):
    problem = pendulum.with_objective({"a": 1.0, "b": 1.0})
    solution = fh.solve_hji(problem, gamma=3 * fh.smallest_gamma(problem), degree=4)
    solution.save(tmp_path / "law.npz")
    loaded = fh.load_solution(tmp_path / "law.npz")
    x = np.array([0.2, 0.1])
    np.testing.assert_allclose(fh.Controller(loaded, None).step(x), loaded.law(x), rtol=1e-12)
    np.testing.assert_allclose(loaded.law(x), solution.law(x), rtol=1e-3)
    exact = fh.load_solution(tmp_path / "law.npz", problem=problem)
    np.testing.assert_allclose(exact.law(x), solution.law(x), rtol=1e-14)


def test_two_plants_do_not_share_the_code_of_their_laws(pendulum):
    other = fh.Plant(
        lambda x, u, d, p: np.array([x[1] + d[0], -np.sin(x[0]) + (1 + x[0] ** 2) * u[0]]),
        lambda x, u, p: x[:1], states=("a", "b"), inputs=("u",), disturbances=("d",),
    )  # fmt: skip
    x = np.array([0.7, 0.1])
    for plant in (pendulum, other):
        problem = plant.with_objective({"a": 1.0, "b": 1.0})
        solution = fh.solve_hji(problem, gamma=3 * fh.smallest_gamma(problem), degree=4)
        np.testing.assert_allclose(fh.Controller(solution, None).step(x), solution.law(x), rtol=1e-12)


def test_a_polynomial_plant_with_g2_of_the_state():
    plant = fh.PolynomialPlant(
        f={(1, 0): [0.0, -1.0], (0, 1): [1.0, -0.2]},
        g1=np.array([[0.0], [1.0]]),
        g2={(0, 0): [[0.0], [1.0]], (1, 0): [[0.1], [0.5]]},
        h={(1, 0): [1.0, 0.0], (0, 1): [0.0, 1.0]},
        r2=[[2.0]],
    )
    solution = fh.solve_hji(plant, gamma=4 * fh.smallest_gamma(plant), degree=4)
    x = np.array([0.4, -0.2])
    np.testing.assert_allclose(fh.Controller(solution, None).step(x), solution.law(x), rtol=1e-12)


def test_the_papers_law_is_a_polynomial():
    problem = fh.paper_arm().problem()
    assert fh.linear_law(problem, gamma=2 * fh.smallest_gamma(problem)).law_is_polynomial
