"""The linearised loop: against plain eigenvalues, and against runs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import flexhinf as fh
from flexhinf.baselines import MotorPD, lqr
from flexhinf.design.bench import Bench
from flexhinf.design.compare import Comparison
from flexhinf.design.compare.linear import bandwidth_of, corners_of, linear_figures
from flexhinf.design.compare.runs import Runner


@pytest.fixture(scope="module")
def bench(asked: Callable[..., Any]) -> Bench:
    robot = fh.load_robot("vertical-rig")
    problem = robot.problem(pose=(0.8,))
    s = asked(estimator="none", period=1e-4)
    return Bench(robot, s, problem.plant, lqr(problem), np.array([0.8]), np.array([0.3]))


def energy(bench: Bench) -> Any:
    from flexhinf.design.modes import stiffness_and_inertia

    return stiffness_and_inertia(bench.model, bench.robot.operating_point(bench.goal))


@pytest.mark.oracle
def test_fast_sampling_of_the_true_state_has_the_damping_of_the_continuous_loop(bench: Bench) -> None:
    law = MotorPD.tuned(bench.robot.problem(pose=(0.8,)), 8.0)
    found = linear_figures(bench, law, energy(bench), [])
    values = np.linalg.eigvals(law.closed_loop())
    damping = min(-v.real / abs(v) for v in values if v.imag > 0.0)
    assert found.damping == pytest.approx(damping, abs=2e-3)
    assert found.stable
    assert found.corners == found.unstable == 0


@pytest.mark.oracle
def test_bandwidth_is_that_of_the_transfer_function_from_the_moved_rest(bench: Bench) -> None:
    """With x_d moved along the rests, ẋ = (A + BK) x − (A + BK) x_d(q): |q(jω)| falls to 1/√2 of rest."""
    problem = bench.robot.problem(pose=(0.8,))
    law = MotorPD.tuned(problem, 6.0)
    loop = law.closed_loop()
    a, b, _, _ = problem.plant.linearise(*law.rest)
    free = np.linalg.solve(np.hstack([a[:, 1:2], a[:, 2:], b]), -a[:, 0])
    moved = np.concatenate([[1.0], free[:3]])
    into = -loop @ moved  # A x_d + B u_d = 0 along the rests

    def size(w: float) -> float:
        return float(abs(np.linalg.solve(1j * w * np.eye(4) - loop, into)[0]))

    assert size(1e-6) == pytest.approx(1.0, rel=1e-6)
    assert size(bandwidth_of(bench, law)) == pytest.approx(np.sqrt(0.5), rel=5e-3)


def test_an_unstable_loop_has_no_margins_but_is_no_mistake(bench: Bench) -> None:
    problem = bench.robot.problem(pose=(0.8,))
    law = lqr(problem)
    wrong = replace(law, gains=-law.gains)
    found = linear_figures(bench, wrong, energy(bench), [])
    assert not found.stable
    assert found.delay_margin == 0.0
    assert np.isinf(found.peak_sensitivity)
    assert np.isinf(bandwidth_of(bench, wrong))


def test_input_noise_is_that_of_a_run_at_the_goal(rig: Comparison) -> None:
    reference = rig.reference
    for name in ("nl-hinf", "pd"):
        row = rig.row(name)
        assert row is not None
        assert row.tuned is not None
        bench = replace(reference.bench, start=reference.bench.goal)
        run = Runner(bench, row.tuned.law, rig.sub_steps).step(8.0).run
        settled = run.signals["input"][2000:, 0]
        assert row.figures["input_noise"] == pytest.approx(float(settled.std()), rel=0.25)


def test_corners_are_parameters_of_the_true_plant(bench: Bench) -> None:
    uncertain = len(bench.robot.uncertain)
    values = corners_of(bench, 5)
    count = min(2**uncertain, 400)
    assert len(values) == count + 2 * uncertain + 1
    assert all(set(one) <= set(bench.true_plant.parameters.values) for one in values)
    loop = linear_figures(bench, lqr(bench.robot.problem(pose=(0.8,))), energy(bench), values)
    assert loop.corners == len(values)


def test_extras_that_are_not_smooth_at_rest_are_left_out(bench: Bench) -> None:
    rough = replace(
        bench, specification=replace(bench.specification, extras=("spring_hardening", "coulomb_friction"))
    )
    from flexhinf.design.compare.linear import linear_bench

    assert linear_bench(rough).specification.extras == ("spring_hardening",)


def test_a_loop_without_equilibrium_has_no_sensitivity_to_accept(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    from flexhinf.analysis import EquilibriumLoop
    from flexhinf.design.compare.linear import sensitivity_at_rest
    from flexhinf.errors import NumericalFailure

    law = lqr(bench.robot.problem(pose=(0.8,)))
    assert sensitivity_at_rest(bench, law) == linear_figures(bench, law, energy(bench), []).peak_sensitivity
    assert np.isinf(sensitivity_at_rest(bench, replace(law, gains=-law.gains)))

    def nowhere(self: object, *arguments: object) -> None:
        raise NumericalFailure("The loop does not rest.", "expected a rest, found none", "another law")

    monkeypatch.setattr(EquilibriumLoop, "linear", nowhere)
    assert np.isinf(sensitivity_at_rest(bench, law))  # nothing is known: not accepted by the search
