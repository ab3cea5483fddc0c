"""One evaluation of a law, judged on one linear loop, and linear figures against other routes to them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm, solve_discrete_are

import flexhinf as fh
from flexhinf.analysis import VELOCITIES, EquilibriumLoop, ProcessNoise, growth_rates, margins
from flexhinf.baselines import MotorPD, lqr
from flexhinf.designs import Specification
from flexhinf.designs.evaluation import LawEvaluation
from flexhinf.designs.loop_setup import LoopSetup

Setups = Callable[..., LoopSetup]


@pytest.mark.ci("evaluates a design")
def test_non_smooth_extras_are_left_out_of_the_linear_loop_in_one_place(setup_of: Setups) -> None:
    """Their slope at standstill would count as damping: 223 ms of delay margin were shown by one report, 92 by the
    other."""
    smooth = LawEvaluation(setup_of("planar-two-link", (0.4, 0.6)))
    rough = LawEvaluation(setup_of("planar-two-link", (0.4, 0.6), extras=("coulomb_friction",)))
    assert rough.setup.left_out == ("coulomb_friction",)
    assert rough.margins.delay_margin_s == pytest.approx(smooth.margins.delay_margin_s, rel=1e-6)
    assert rough.margins.bandwidth == pytest.approx(smooth.margins.bandwidth, rel=1e-6)
    s = rough.setup
    with_slope = EquilibriumLoop(
        s.law, s.estimator(s.goal), s.robot.plant(extras="coulomb_friction"), 1e-3, equilibrium=s.goal_equilibrium,
        positions=s.model.states[:2],
    )  # fmt: skip
    assert margins(with_slope).delay_margin_s > 1.5 * rough.margins.delay_margin_s  # what was shown before


@pytest.mark.ci("evaluates a design")
@pytest.mark.oracle
def test_a_law_is_judged_with_damped_springs_and_undamped_ones_are_shown(setup_of: Setups) -> None:
    """Against the same loop round a plant of which D = 2ζ K/ω at home is stated, and round one without D."""
    stated = setup_of("planar-two-link", (0.4, 0.6), latency=1)
    names = [f"damping_{joint}" for joint in stated.joints]
    kept = [p for p in stated.robot.parameters if p.name not in names]
    bare = replace(stated, robot=replace(stated.robot, parameters=kept))
    stiffness, inertia, _ = LawEvaluation(bare).energy
    twice = 1.0 / np.diag(inertia)[2:] + np.diag(np.linalg.inv(inertia[:2, :2]))
    own = (2.0 * 0.005 * stiffness / np.sqrt(stiffness * twice)).tolist()
    by_hand = stated.robot.with_values(dict(zip(names, own, strict=True)))

    def by_plant(plant: Any) -> Any:
        s = stated.specification
        return margins(EquilibriumLoop(
            bare.law, bare.estimator(bare.goal), plant, s.period, equilibrium=bare.goal_equilibrium,
            latency=s.known_latency, delay=s.unknown_samples, positions=bare.model.states[:2],
        ))  # fmt: skip

    for setup, robot in ((bare, by_hand), (stated, stated.robot)):
        law = LawEvaluation(setup)
        damped, free = by_plant(robot.plant(extras="joint_damping")), by_plant(robot.plant())
        assert law.undamped_margins is not None
        for found, expected in ((law.margins, damped), (law.undamped_margins, free)):
            assert found.delay_margin_s == pytest.approx(expected.delay_margin_s, rel=1e-8)
            assert found.damping_about(40.0) == pytest.approx(expected.damping_about(40.0), rel=1e-6)
        assert abs(free.delay_margin_s / damped.delay_margin_s - 1.0) > 1e-5
    kept.append(stated.robot["damping_shoulder"])
    some = LawEvaluation(replace(bare, robot=replace(bare.robot, parameters=kept)))
    assert some.corners is not None
    known = np.array([corner["damping"] for corner in some.corners.population.values])
    ends = np.unique(np.round(known, 9), axis=0)
    np.testing.assert_allclose(ends, [[d, own[1]] for d in (0.15, 0.3, 0.45)], rtol=1e-7)


def test_the_inductance_stays_in_the_linear_loop(setup_of: Setups) -> None:
    coil = setup_of("paper", (np.pi / 2,), (0.0,), extras=("inductance",))
    assert coil.left_out == ()
    assert coil.smooth_plant is coil.true_plant
    assert "coil_current" in coil.equilibrium_loop().plant.states


@pytest.mark.ci("evaluates a design")
@pytest.mark.oracle
def test_damping_is_that_of_every_oscillation_of_the_loop_margins(setup_of: Setups) -> None:
    """Of law and estimator separately: with the nominal plant the sampled loop has the modes of both."""
    setup = setup_of("paper", (np.pi / 2,), (0.0,), estimator="ekf", torque_noise=1e-9)
    found = LawEvaluation(setup)
    a, b, _, c = setup.model.linearise(*setup.goal_equilibrium)
    whole = expm(1e-3 * np.block([[a, b], [np.zeros((1, 5))]]))
    noise = np.diag([0.0, 1e-9, 0.0, 1e-9])
    f = whole[:4, :4]
    p = solve_discrete_are(f.T, c.T, noise, 1e-8 * np.eye(1))
    error = f @ (np.eye(4) - p @ c.T @ np.linalg.inv(c @ p @ c.T + 1e-8) @ c)

    def damping(multipliers: np.ndarray) -> float:
        rates = np.log(multipliers[np.abs(multipliers) > 1e-9].astype(complex))
        rates = rates[np.abs(rates.imag) > 1e-9]
        return float((-rates.real / np.abs(rates)).min())

    fed_back = LawEvaluation(replace(setup, specification=replace(setup.specification, estimator="none")))
    both = min(damping(np.linalg.eigvals(error)), fed_back.margins.damping)
    assert found.margins.damping == pytest.approx(both, rel=1e-3)


@pytest.mark.ci("evaluates a design")
def test_the_loop_as_designed_has_the_noise_of_the_specification(setup_of: Setups) -> None:
    setup = setup_of("paper", (np.pi / 2,), (0.0,), torque_noise=1e-5)
    found = LawEvaluation(setup)
    assert found.corners is not None
    assert found.corners.count == 2048
    every = np.arange(100)
    same = growth_rates(found.loop, found.corners.population, (ProcessNoise(VELOCITIES, 1e-5),), every)[0]
    np.testing.assert_allclose(found.corners.designed.rates[:100], same.rates, rtol=1e-6)


def test_without_tolerances_there_are_no_corners_and_without_an_estimator_nothing_to_retune(
    robot_of: Callable[[str], Any], setup_of: Setups, only_uncertain: Callable[..., Any]
) -> None:
    setup = setup_of("paper", (np.pi / 2,), (0.0,), estimator="none")
    certain = replace(setup, robot=only_uncertain(robot_of("paper")))
    assert LawEvaluation(certain).corners is None
    few = replace(setup, robot=only_uncertain(robot_of("paper"), "stiffness"))
    corners = LawEvaluation(few).corners
    assert corners is not None
    assert (corners.count, corners.swept) == (2, ())


def test_other_sensors_and_noise_levels_make_another_loop(setup_of: Setups) -> None:
    """Its own sensors and R^v, everything else shared."""
    setup = setup_of("paper", (np.pi / 2,), (0.0,))
    motor = replace(setup, specification=replace(setup.specification, measured=("motor_position",)))
    assert motor.model.outputs == ("motor_position",)
    assert motor.estimator(motor.goal).plant.outputs == ("motor_position",)
    faster = replace(setup, estimator_noise=setup.process_noise.scaled(100.0, 1.0, "test"))
    assert np.diag(faster.estimator(setup.goal).process_noise) == pytest.approx([0.0, 1e-5, 0.0, 1e-5])


@pytest.mark.ci("evaluates a design")
def test_every_figure_of_the_worst_joint_names_it(setup_of: Setups) -> None:
    response = setup_of("planar-two-link", (0.4, 0.6), (0.2, 0.9)).step(1.0)
    assert [row["joint"] for row in response.metrics] == ["shoulder", "elbow"]
    assert response.overshoot.joint in ("shoulder", "elbow")
    assert response.peak.joint in ("shoulder", "elbow")


# Linear figures of a law in its loop ------------------------------------------------------------------------
@pytest.fixture(scope="module")
def fast() -> LoopSetup:
    """The true state fed back at 10 kHz: almost the continuous loop."""
    robot = fh.load_robot("vertical-rig")
    s = Specification(pose=(0.8,), start=(0.3,), estimator="none", period=1e-4)
    law = lqr(robot.problem(pose=(0.8,)))
    return LoopSetup(robot, s, law, np.array([0.8]), np.array([0.3]))


@pytest.mark.oracle
def test_fast_sampling_of_the_true_state_has_the_damping_of_the_continuous_loop(fast: LoopSetup) -> None:
    law = MotorPD.tuned(fast.robot.problem(pose=(0.8,)), 8.0)
    found = LawEvaluation(replace(fast, law=law)).margins
    values = np.linalg.eigvals(law.closed_loop())
    assert found.stable
    assert found.damping == pytest.approx(min(-v.real / abs(v) for v in values if v.imag > 0.0), abs=2e-3)


@pytest.mark.oracle
def test_bandwidth_is_that_of_the_transfer_function_from_the_moved_equilibrium(fast: LoopSetup) -> None:
    """With x_d moved along the equilibria, ẋ = (A + BK) x − (A + BK) x_d(q): |q(jω)| falls to 1/√2 of that at 0."""
    problem = fast.robot.problem(pose=(0.8,))
    law = MotorPD.tuned(problem, 6.0)
    loop = law.closed_loop()
    a, b, _, _ = problem.plant.linearise(*law.equilibrium)
    free = np.linalg.solve(np.hstack([a[:, 1:2], a[:, 2:], b]), -a[:, 0])
    into = -loop @ np.concatenate([[1.0], free[:3]])  # A x_d + B u_d = 0 along the equilibria

    def size(w: float) -> float:
        return float(abs(np.linalg.solve(1j * w * np.eye(4) - loop, into)[0]))

    bandwidth = LawEvaluation(replace(fast, law=law)).margins.slowest_bandwidth
    assert size(1e-6) == pytest.approx(1.0, rel=1e-6)
    assert size(bandwidth) == pytest.approx(np.sqrt(0.5), rel=5e-3)


def test_an_unstable_loop_has_no_margins_but_is_no_mistake(fast: LoopSetup) -> None:
    law: Any = fast.law
    found = LawEvaluation(replace(fast, law=replace(law, gain=-law.gain)))
    assert not found.margins.stable
    assert found.margins.delay_margin_s == 0.0
    assert np.isinf(found.margins.peak_sensitivity)
    assert found.linear_failure == ""


@pytest.mark.oracle
def test_a_constant_load_leaves_what_the_spring_and_the_gain_give(fast: LoopSetup) -> None:
    """PD, the true state fed back: at rest (K + G') δq − K δθ = d, and K δq = (K + K_p) δθ."""
    law = MotorPD.tuned(fast.robot.problem(pose=(0.8,)), 6.0)
    setup = replace(fast, law=law, specification=replace(fast.specification, period=1e-3))
    found = setup.load_response(np.array([0.001]), 6.0, 8).remaining.value
    k, slope, p = law.joints.stiffness[0], law.joints.gravity_slope[0, 0], law.proportional[0]
    away = abs(np.linalg.solve([[k + slope, -k], [-k, k + p]], [0.001, 0.0])[0])
    assert found == pytest.approx(away, rel=0.03)
