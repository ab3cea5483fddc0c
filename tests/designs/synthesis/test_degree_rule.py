"""The degree that a design uses: the lowest one whose step no higher one makes clearly cheaper."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import flexhinf as fh
from flexhinf.designs import Specification
from flexhinf.designs.loop_setup import LoopSetup
from flexhinf.designs.problem.presets import choose
from flexhinf.designs.synthesis.by_step import (
    ACTING,
    GAIN,
    DegreeChoice,
    choose_degree,
    solve_degrees,
    step_cost,
)
from flexhinf.designs.synthesis.steps import synthesise
from flexhinf.robot import Robot

Choices = tuple[DegreeChoice, ...]


def decided(
    robot: Robot, extras: tuple[str, ...] = (), **fields: object
) -> tuple[DegreeChoice, Choices, LoopSetup]:
    """The rule alone, with weights that are searched for and noise levels that are stated."""
    s = Specification(**{"preset": "damped", "torque_noise": 1e-6, "draws": 0, **fields})  # type: ignore[arg-type]
    goal, start = (robot.operating_point(pose)[0][: len(robot.joint_names)] for pose in (s.pose, s.start))
    made = choose(robot, goal, start, s)
    problem = robot.problem(made.penalty, pose=goal, extras=extras)
    gamma = s.gamma_ratio * fh.smallest_gamma(problem)
    solved = tuple(solve_degrees(problem, s.degrees or (2, 4, 6), gamma))
    setup = LoopSetup(robot, replace(s, extras=extras), solved[0].solution, goal, start)
    return *choose_degree(setup, problem, solved), setup


OTHERS = pytest.mark.nightly("other seeds")
SEEDS = [
    ("paper", 0),
    ("vertical-rig", 5),
    *(
        pytest.param(name, seed, marks=OTHERS)
        for name, seed in (("paper", 5), ("paper", 9), ("vertical-rig", 0), ("vertical-rig", 9))
    ),
]


@pytest.mark.ci("searches weights, runs three laws")
@pytest.mark.parametrize(("name", "seed"), SEEDS)
def test_a_long_step_against_gravity_takes_the_cubic_law(name: str, seed: int) -> None:
    used, (linear, cubic, quintic), _ = decided(fh.load_robot(name), pose="90deg", start=0.0, seed=seed)
    assert used is cubic
    assert cubic.acting > 1.0
    assert cubic.cost < (1.0 - GAIN) * linear.cost
    assert quintic.cost > (1.0 - GAIN) * cubic.cost, "one degree more saves nothing"


@pytest.mark.ci("weights are searched, a loop compiled")
@pytest.mark.parametrize("name", ["paper", "vertical-rig"])
def test_a_short_step_takes_the_linear_law_without_a_run_of_the_others(name: str) -> None:
    used, (linear, *higher), _ = decided(fh.load_robot(name), pose="90deg", start="80deg")
    assert used is linear
    assert np.isfinite(linear.cost)
    for choice in higher:
        assert choice.acting < ACTING
        assert np.isnan(choice.cost)


@pytest.mark.ci("searches weights, runs three laws")
def test_a_robot_without_gravity_takes_the_linear_law_for_any_step() -> None:
    used, choices, _ = decided(fh.load_robot("quanser-rotflex"), pose="90deg", start="-90deg")
    assert used.degree == 2
    assert max(choice.acting for choice in choices[1:]) < 1e-9


@pytest.mark.ci("searches weights, runs three laws")
def test_a_higher_degree_keeps_the_limits_that_the_lower_one_keeps() -> None:
    """The cubic law overshoots by 0.5 % here, the linear one not at all."""
    fields = {"pose": "90deg", "start": 0.0, "measurement_noise": 1e-12}
    free, *_ = decided(fh.paper_arm(), **fields)
    used, (_, cubic, _), _ = decided(fh.paper_arm(), overshoot=0.1, **fields)
    assert (free.degree, free.missed) == (4, ())
    assert used.degree == 2
    assert cubic.missed == ("overshoot",)


@pytest.mark.ci("searches weights, runs three laws")
def test_a_limit_counts_on_robots_within_the_tolerances() -> None:
    fields = {"pose": "90deg", "start": 0.0, "measurement_noise": 1e-12, "overshoot": 0.7}
    assert decided(fh.paper_arm(), **fields)[0].degree == 4
    used, (_, cubic, quintic), _ = decided(fh.paper_arm(), **{**fields, "draws": 1})
    assert cubic.missed == ("overshoot",)
    assert used is quintic, "dearer than the cubic law, cheaper than the linear one, and within the limit"


@pytest.mark.ci("searches weights, runs three laws")
def test_a_law_whose_step_diverges_is_not_used() -> None:
    """A spring that hardens fast: polynomials of degree 3 and 5 leave the plant behind at the start of the step."""
    stiffening = fh.paper_arm().with_parameters(fh.Parameter("spring_hardening", 3000.0))
    used, (linear, *higher), _ = decided(
        stiffening, ("spring_hardening",), pose="180deg", start="60deg", estimator="none"
    )
    assert used is linear
    assert any(np.isinf(choice.cost) for choice in higher)


@pytest.mark.ci("compiles a loop of its own")
@pytest.mark.oracle
def test_the_cost_is_the_integral_of_the_squared_penalty() -> None:
    """Summed up from the run by the weights, the integral of the error left out."""
    weights = {"link_position": 60.0, "link_position_integral": 300.0, "motor_velocity": 5.0}
    problem = fh.paper_arm().problem(fh.Penalty(weights, effort=10.0), pose=(1.5,))
    choice = next(solve_degrees(problem, (4,), 1.5 * fh.smallest_gamma(problem)))
    s = Specification(pose=(1.5,), start=(1.0,), penalty=weights, torque_noise=1e-6)
    step = LoopSetup(fh.paper_arm(), s, choice.solution, np.array([1.5]), np.array([1.0])).step(3.0)
    x, u = step.run.signals["state"], step.inputs[:, 0] - problem.operating_input[0]
    square = (60.0 * (x[:, 0] - 1.5)) ** 2 + (5.0 * x[:, 3]) ** 2 + 10.0 * u**2
    assert step_cost(problem, step) == pytest.approx(1e-3 * square.sum(), rel=2e-3)
    diverged = replace(step, run=replace(step.run, diverged_at=1.0))
    assert step_cost(problem, diverged) == np.inf


@pytest.mark.ci("searches weights, runs three laws")
def test_only_the_region_of_the_degree_that_is_used_is_sampled() -> None:
    asked = Specification(pose="90deg", start=0.0, preset="damped", torque_noise=1e-6, rays=20, draws=0)
    made = synthesise(fh.paper_arm(), asked, lambda text: None)
    assert [choice.degree for choice in made.choices] == [2, 4, 6]
    assert made.chosen is made.choices[1]
    assert [choice.looked for choice in made.choices] == [False, True, False]
    assert made.chosen.step_amplitude > 1.0


@pytest.mark.ci("searches weights, runs three laws")
def test_a_stated_degree_is_used() -> None:
    asked = Specification(
        pose="90deg", start="80deg", preset="damped", torque_noise=1e-6, rays=20, degrees=(4,)
    )
    made = synthesise(fh.paper_arm(), asked, lambda text: None)
    assert (made.chosen.degree, made.chosen.looked, len(made.choices)) == (4, True, 1)
