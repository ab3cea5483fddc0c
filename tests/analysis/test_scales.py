"""Weights from target frequency and damping weight: closed forms, laws of similarity, and two texts of the same h."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.linalg import eigh, solve_continuous_are

from flexhinf.analysis.modes import JointScales
from flexhinf.designs.problem.weights import LinearFamily, LinearProblem
from flexhinf.robot.layout import Layout

pytestmark = pytest.mark.oracle


def scales_of(robot: Any, goal: Any = None) -> JointScales:
    return JointScales.of(robot.plant(), robot.operating_point(goal))


@pytest.mark.parametrize("name", ["paper", "planar-two-link", "cart", "seven-link"])
@pytest.mark.parametrize("damping", [0.0, 0.7])
def test_rows_and_penalty_are_two_texts_of_one_h(
    robot_of: Callable[[str], Any], name: str, damping: float
) -> None:
    rng, robot = np.random.default_rng(4), robot_of(name)
    scales = scales_of(robot)
    pace = rng.uniform(0.3, 3.0, len(robot.joint_names)) * scales.antiresonance
    rows = scales.rows(pace, damping)
    problem = robot.problem(scales.penalty(pace, damping))
    points = rng.normal(size=(20, len(problem.state_names)))
    h = problem.fields(points)[3]
    ours = points @ rows.T
    assert h.shape == ours.shape == (20, (5 if damping else 4) * len(robot.joint_names))
    assert np.sort(h, axis=1) == pytest.approx(np.sort(ours, axis=1), rel=1e-12)
    assert problem.r2 == pytest.approx(np.eye(len(robot.joint_names)))


def test_a_spring_between_two_masses_gets_the_damping_of_its_weight() -> None:
    """Its motor paid with uᵀu, and nothing penalised but the rate of the spring's torque; SciPy's equation."""
    rng = np.random.default_rng(0)
    for zeta in (0.05, 0.3, 0.9):
        link, motor, stiffness, per_input = rng.uniform(0.1, 3.0, 4)
        one = (np.array([v]) for v in (stiffness, link, motor, 0.0, per_input))
        scales = JointScales(*one, float(np.sqrt(stiffness / link)), Layout(1))
        weight = scales.weights(np.array([1.0]), zeta)["joint_torque_rate"][0]
        square = stiffness * (1 / link + 1 / motor)
        a, b = np.array([[0.0, 1.0], [-square, 0.0]]), np.array([[0.0], [per_input / motor]])
        rate = weight * stiffness * np.array([[0.0, 1.0]])
        p = solve_continuous_are(a, b, rate.T @ rate, np.eye(1))
        loop = np.linalg.eigvals(a - b @ b.T @ p)
        assert np.abs(loop) == pytest.approx(np.sqrt(square), rel=1e-9)
        assert -loop.real / np.abs(loop) == pytest.approx(zeta, rel=1e-9)
        assert scales.vibration == pytest.approx(np.sqrt(square))


def test_the_input_costs_as_much_as_the_position_at_the_pace() -> None:
    """(M + J) q̈ + d q̇ = k u, driven with u = sin ωt, in steady state: |w q| = |u|."""
    link, motor, drag, per_input, pace = 0.7, 1.9, 3.0, 2.5, 4.0
    one = (np.array([v]) for v in (50.0, link, motor, drag, per_input))
    weights = JointScales(*one, 1.0, Layout(1)).weights(np.array([pace]), 0.0)
    response = per_input / ((link + motor) * (1j * pace) ** 2 + drag * 1j * pace)
    assert weights["link_position"][0] * abs(response) == pytest.approx(1.0)


@pytest.mark.parametrize("name", ["planar-two-link", "seven-link", "cart"])
def test_inertia_stiffness_and_lowest_vibration_are_those_of_newton_and_euler(
    robot_of: Callable[[str], Any], name: str
) -> None:
    robot = robot_of(name)
    q, n = np.array(robot.home), len(robot.joint_names)
    p = robot.plant().parameters.named(robot.plant().parameters.vector())
    still = robot.links.torques(q, 0 * q, 0 * q, p)
    columns = [robot.links.torques(q, 0 * q, unit, p) - still for unit in np.eye(n)]
    inertia = np.array(columns, dtype=float).T
    scales = scales_of(robot)
    assert scales.link_inertia == pytest.approx(np.diag(inertia), rel=1e-9)
    stiffness = [robot.nominal[f"stiffness_{joint}"] for joint in robot.joint_names]
    assert scales.stiffness == pytest.approx(stiffness)
    lowest = eigh(np.diag(stiffness), inertia, eigvals_only=True)[0]
    assert scales.antiresonance == pytest.approx(np.sqrt(lowest), rel=1e-9)


def test_the_motors_damping_counts_the_back_emf_and_the_gear() -> None:
    import flexhinf as fh

    robot = fh.load_robot("quanser-rotflex")
    v, scales = robot.nominal, scales_of(robot)
    gear = v["gear_ratio"]
    per_volt = v["gear_efficiency"] * v["motor_efficiency"] * gear * v["torque_constant"] / v["resistance"]
    drag = v["friction"] + per_volt * gear * v["back_emf_constant"]
    assert scales.per_input == pytest.approx(per_volt, rel=1e-9)
    assert scales.damping == pytest.approx(drag, rel=1e-9)


def _loop(robot: Any, pace: np.ndarray, damping: float) -> tuple[np.ndarray, np.ndarray, float]:
    """Eigenvalues, gain and γ* of the linear design."""
    family, scales = LinearFamily.of(robot, np.array(robot.home), members=0), scales_of(robot)
    game = LinearProblem.of(family, scales.rows(pace, damping), True)
    star = game.gamma_star
    design = game.design(1.5 * star)
    a, b = family.a[0], family.b[0]
    return np.sort_complex(np.linalg.eigvals(a + b @ design.gain)), design.gain, star


HEAVIER = ("mass", "inertia", "axis_inertia", "rotor_inertia", "motor_inertia", "stiffness", "friction")


def _times(robot: Any, names: tuple[str, ...], factor: float) -> Any:
    found = {p.name: factor * p.value for p in robot.parameters if p.name.startswith(names)}
    return robot.with_values(found)


def test_a_robot_four_times_as_heavy_and_as_stiff_moves_alike_with_four_times_the_gain(
    robot_of: Callable[[str], Any],
) -> None:
    robot = robot_of("cart")
    heavy = _times(robot, HEAVIER, 4.0)
    pace = np.array([7.0, 9.0])
    modes, gain, star = _loop(robot, pace, 0.3)
    other, more, higher = _loop(heavy, pace, 0.3)
    for name, weight in scales_of(robot).weights(pace, 0.3).items():
        factor = 1.0 if name == "joint_torque_rate" else 4.0
        assert scales_of(heavy).weights(pace, 0.3)[name] == pytest.approx(factor * weight, rel=1e-9)
    assert other == pytest.approx(modes, rel=1e-6)
    assert more == pytest.approx(4.0 * gain, rel=1e-3)  # γ* is found to 1e-3
    assert higher == pytest.approx(4.0 * star, rel=3e-3)


def test_a_robot_twice_as_fast_gets_a_loop_twice_as_fast(robot_of: Callable[[str], Any]) -> None:
    """Stiffness and weight four times, friction twice: time runs at double speed, gain of the positions fourfold."""
    robot = robot_of("cart")
    fast = _times(robot, ("stiffness", "gravity"), 4.0)
    fast = _times(fast, ("friction",), 2.0)
    pace = np.array([7.0, 9.0])
    modes, gain, _ = _loop(robot, pace, 0.3)
    other, more, _ = _loop(fast, 2.0 * pace, 0.3)
    factors = np.repeat([4.0, 2.0, 4.0, 2.0, 8.0], 2)
    assert other == pytest.approx(2.0 * modes, rel=2e-3)
    assert more == pytest.approx(factors * gain, rel=5e-3, abs=1e-6 * np.abs(gain).max())


def test_other_units_of_the_input_change_nothing_but_its_numbers() -> None:
    """Half the volts per torque: the same loop with half the gain."""
    import flexhinf as fh

    robot = fh.load_robot("quanser-rotflex")
    halved = robot.with_values(
        {name: 2.0 * robot.nominal[name] for name in ("torque_constant",)}
        | {"back_emf_constant": 0.5 * robot.nominal["back_emf_constant"]}
    )
    modes, gain, _ = _loop(robot, np.array([6.0]), 0.2)
    other, half, _ = _loop(halved, np.array([6.0]), 0.2)
    assert other == pytest.approx(modes, rel=2e-3)
    assert half == pytest.approx(0.5 * gain, rel=5e-3)
