"""The dissipation inequality at corners, against rates of the nonlinear plant and the gain of the loop."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import flexhinf as fh
from flexhinf.analysis import DiscreteSystem, DissipationCorners, dissipation_corners
from flexhinf.errors import InvalidInput
from flexhinf.robot import Robot

#: The robust design of the paper's arm at 180° when each tolerance was covered alone: weights, γ, K and P.
WEIGHTS = {
    "link_position": 73.75741971846307, "link_velocity": 6.413342020253735, "motor_velocity": 6.413342020253735,
    "joint_torque_rate": 0.09119580493221288, "link_position_integral": 212.06404345601595,
}  # fmt: skip
GAMMA = 160.030747628079
GAIN = np.array([[63.572903071298, -27.652180086435, -376.761970249425, -32.550626818688, -485.735505302438]])
STORAGE = np.array([
    [4.596554903377e03, 1.496617759084e01, -3.627944196114e03, -7.788348153853e01, 3.664291597547e03],
    [1.496617759084e01, 1.311782401112e02, 9.647487560657e02, 3.387682413758e01, 1.691846130652e03],
    [-3.627944196114e03, 9.647487560657e02, 1.197686071593e04, 4.615729742817e02, 1.372716518681e04],
    [-7.788348153853e01, 3.387682413758e01, 4.615729742817e02, 3.987793573085e01, 5.950769971509e02],
    [3.664291597547e03, 1.691846130652e03, 1.372716518681e04, 5.950769971509e02, 5.340841162233e04],
])  # fmt: skip


def names_of(arm: Robot) -> list[str]:
    """Uncertain numbers that the arm without its coil has."""
    return [parameter.name for parameter in arm.uncertain if parameter.name != "inductance"]


def checked(arm: Robot, solution: Any, problem: Any, goal: float, **options: Any) -> DissipationCorners:
    names = names_of(arm)
    return dissipation_corners(
        solution, problem,
        lambda signs: arm.corner(dict(zip(names, signs, strict=True))), len(names),
        lambda values: arm.operating_point([goal], parameters=values), **options,
    )  # fmt: skip


@pytest.fixture(scope="module")
def alone(arm: Robot) -> tuple[Any, Any, DissipationCorners]:
    """The old robust design: its problem, its solution, and the inequality at the corners."""
    problem = arm.problem(penalty=fh.Penalty(WEIGHTS, effort=1.0), pose=[math.pi])
    solution = SimpleNamespace(P=STORAGE, gain=GAIN, gamma=GAMMA, state_names=problem.state_names)
    return problem, solution, checked(arm, solution, problem, math.pi)


def test_products_of_tolerances_break_an_inequality_that_covers_each_alone(
    arm: Robot, alone: tuple[Any, Any, DissipationCorners]
) -> None:
    """108 of 1024 corners at 180°, where m·g·l and k_t/R act together."""
    _, _, found = alone
    assert found.complete
    assert (found.failing, found.count) == (108, 1024)
    assert found.excess[-1] == 0.0
    for text in ("mass +5 %", "length +3 %", "gravity +1 %", "resistance +4 %", "torque constant -3 %"):
        assert text in found.describe()
    assert repr(found).startswith("DissipationCorners(108 of 1024")
    # Each tolerance alone is covered.
    problem, solution, _ = alone
    for name in names_of(arm):
        single = dissipation_corners(
            solution, problem, lambda signs, name=name: arm.corner({name: signs[0]}), 1,
            lambda values: arm.operating_point([math.pi], parameters=values),
        )  # fmt: skip
        assert single.failing == 0


@pytest.mark.oracle
def test_the_nonlinear_rates_exceed_the_supply_at_failing_corners_only(
    arm: Robot, alone: tuple[Any, Any, DissipationCorners]
) -> None:
    """V̇ − ½ γ²|d|² + ½ |z|² of small motions of the robot itself under the worst d: no matrix of the corner."""
    problem, solution, found = alone
    p, gain, gamma = solution.P, solution.gain, solution.gamma
    size = 1.0 / np.sqrt(np.diag(p))
    rng = np.random.default_rng(0)
    for k in (found.worst, int(np.argmin(found.excess))):
        values = problem.plant.parameters.known(found.population.values[k])
        plant = problem.plant.with_parameters(**values)
        rest, held = arm.operating_point([math.pi], parameters=values)

        def over(x: np.ndarray, plant=plant, rest=rest, held=held) -> float:
            x = 1e-5 * size * x
            r = -(p @ x)[-1] / gamma**2
            rate = np.append(plant.derivative(rest + x[:4], held + gain @ x), x[0] - r)
            h, u = problem.fields(x[None])[3][0], gain @ x
            return float(x @ p @ rate - 0.5 * (gamma**2 * r * r - h @ h - u @ problem.r2 @ u)) / 1e-10

        # Ascent on the quadratic form by differences of `over`.
        unit = np.eye(5)
        whole = np.array([[over(a + b) - over(a) - over(b) for b in unit] for a in unit])
        values_of, vectors = np.linalg.eigh(whole / 2.0)
        if found.excess[k] > 0.0:
            assert 2.0 * values_of[-1] == pytest.approx(found.excess[k], rel=1e-2)
        assert (over(vectors[:, -1]) > 0.0) == (found.excess[k] > 0.0)
        if found.excess[k] == 0.0:
            assert max(over(rng.normal(size=5)) for _ in range(300)) < 1e-6


@pytest.mark.oracle
def test_where_it_holds_the_loop_has_the_gain(arm: Robot, alone: tuple[Any, Any, DissipationCorners]) -> None:
    """The bounded real lemma: corners without excess have an H∞ norm of at most γ, by the loop sampled finely."""
    problem, solution, found = alone
    c = np.vstack([problem.expand(1).h_parts[1], np.linalg.cholesky(problem.r2).T @ solution.gain])
    for k in np.flatnonzero(found.excess[:-1] == 0.0)[::200]:
        values = problem.plant.parameters.known(found.population.values[k])
        plant = problem.plant.with_parameters(**values)
        state, inputs, _, _ = plant.linearise(*arm.operating_point([math.pi], parameters=values))
        a, b = np.zeros((5, 5)), np.zeros((5, 1))
        a[:4, :4], b[:4], a[4, 0] = state, inputs, 1.0
        command = np.array([[0.0], [0.0], [0.0], [0.0], [-1.0]])
        from scipy.linalg import expm

        both, period = np.zeros((6, 6)), 1e-4
        both[:5] = np.hstack([a + b @ solution.gain, command])
        moved = expm(both * period)[:5]
        norm = DiscreteSystem(moved[:, :5], moved[:, 5:], c, np.zeros((len(c), 1)), period).norm()[0]
        assert norm <= GAMMA * (1.0 + 1e-3)


@pytest.mark.ci("one more region is sampled")
def test_the_law_of_a_nominal_problem_covers_its_own_robot_alone(arm: Robot) -> None:
    """Q = 0 for the robot that the law was made for; a larger γ is easier, a smaller one fails there too."""
    problem = arm.problem(pose=[1.0])
    star = fh.smallest_gamma(problem)
    solution = fh.solve_hji(problem, gamma=1.5 * star, degree=2)
    found = checked(arm, solution, problem, 1.0)
    assert found.excess[-1] == 0.0 < found.excess[found.worst]
    assert found.failing > 100
    smaller, larger = (checked(arm, solution, problem, 1.0, gamma=g * star) for g in (1.2, 3.0))
    assert smaller.excess[-1] > 0.0 == larger.excess[-1]
    assert larger.failing <= found.failing


def test_a_solution_of_other_states_is_refused(arm: Robot) -> None:
    problem = arm.problem(pose=[1.0])
    other = SimpleNamespace(
        P=np.eye(4), gain=np.zeros((1, 4)), gamma=1.0, state_names=problem.state_names[:4]
    )
    with pytest.raises(InvalidInput, match="states"):
        checked(arm, other, problem, 1.0)
