"""Which game is played: presets, defaults, contradictions, and what is solved in the end."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from tests.refusals import refused_with, unnamed
from tests.tiers import ci_and_night

import flexhinf as fh
from flexhinf.analysis.modes import closed_loop
from flexhinf.designs import Specification
from flexhinf.designs.problem.presets import (
    DAMPING,
    DesignProblem,
    channels,
    choose,
    preset_of,
    required_damping,
)
from flexhinf.designs.problem.weights import BANDWIDTH_FRACTION, DampingOutOfReach, LinearFamily
from flexhinf.errors import InvalidInput

Named = Callable[[str], Any]
Games = Callable[..., DesignProblem]

WEIGHTS = {"link_position": 3.0, "link_position_integral": 5.0}


# Which preset is meant ------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("asked", "own", "none"),
    [
        ({}, "paper", "damped"),
        ({"preset": "paper"}, "paper", "paper"),
        ({"preset": "damped"}, "damped", "damped"),
        ({"preset": "robust"}, "robust", "robust"),
        ({"bandwidth": 2.0}, "damped", "damped"),
        ({"damping": 0.1}, "damped", "damped"),
        ({"preset": "robust", "bandwidth": 2.0, "damping": 0.1}, "robust", "robust"),
        ({"penalty": WEIGHTS}, "given", "given"),
        ({"penalty": WEIGHTS, "effort": 2.0}, "given", "given"),
        ({"effort": 2.0}, "paper", "paper"),
        ({"preset": "paper", "effort": 2.0}, "paper", "paper"),
        ({"peak_effort": 60.0}, "paper", "damped"),
    ],
)
def test_the_preset_that_is_meant(robot_of: Named, asked: dict[str, Any], own: str, none: str) -> None:
    robot = robot_of("paper")
    assert preset_of(robot, Specification(**asked)) == own
    assert preset_of(replace(robot, penalty=None), Specification(**asked)) == none


@pytest.mark.parametrize(
    ("asked", "both", "advice"),
    [
        ({"bandwidth": 2.0, "penalty": WEIGHTS}, "`bandwidth` and `penalty`", "one"),
        ({"damping": 0.2, "effort": 2.0}, "`damping` and `effort`", "one"),
        ({"preset": "damped", "penalty": WEIGHTS}, "preset='damped' and `penalty`", "out `penalty`"),
        ({"preset": "robust", "effort": 2.0}, "preset='robust' and `effort`", "out `effort`"),
        ({"preset": "paper", "bandwidth": 2.0}, "preset='paper' and `bandwidth`", "preset='damped'"),
        ({"preset": "paper", "damping": 0.2}, "preset='paper' and `damping`", "preset='damped'"),
        ({"preset": "paper", "penalty": WEIGHTS}, "preset='paper' and `penalty`", "out `preset`"),
    ],
)
def test_what_contradicts_itself_is_refused_in_three_parts(
    robot_of: Named, asked: dict[str, Any], both: str, advice: str
) -> None:
    with pytest.raises(InvalidInput) as refused:
        choose(robot_of("paper"), np.array([0.0]), np.array([0.1]), Specification(**asked))
    what, found, attempt = str(refused.value).splitlines()
    assert what.split(" contradict")[0].endswith(both)
    assert "weights" in found
    assert advice in attempt


@pytest.mark.ci("searches weights")
def test_bandwidths_fit_the_joints_or_are_refused(robot_of: Named, problem_of: Games) -> None:
    with pytest.raises(InvalidInput, match="bandwidths") as refused:
        choose(robot_of("cart"), np.zeros(2), np.zeros(2), Specification(bandwidth=[1.0, 2.0, 3.0]))
    assert "or 2, got [1.0, 2.0, 3.0]" in str(refused.value)
    game = problem_of("cart", bandwidth=(4.0, 2.0), damping=0.1)
    assert game.target is not None
    assert game.target.bandwidth.tolist() == [4.0, 2.0]


# What is stated -------------------------------------------------------------------------------------
@pytest.mark.ci("searches of weights")
def test_who_says_so_is_never_silent(robot_of: Named, problem_of: Games) -> None:
    own = problem_of("vertical-rig")
    assert own.penalty is robot_of("vertical-rig").penalty
    assert (own.preset, own.source) == ("paper", own.effort_source)
    assert unnamed(own.source, "robot", "file") == []
    asked = problem_of("vertical-rig", penalty=WEIGHTS, effort=2.0)
    assert (asked.preset, asked.source, asked.effort_source) == (
        "given", "option --set penalty", "option --set effort",
    )  # fmt: skip
    assert asked.penalty.effort == 2.0
    kept = problem_of("vertical-rig", penalty=WEIGHTS)
    assert (kept.source, kept.effort_source) == (asked.source, own.effort_source)
    assert kept.penalty.effort == 4.0
    mine = problem_of("vertical-rig", penalty=fh.Penalty(WEIGHTS, effort=7.0))
    assert (mine.effort_source, mine.penalty.effort) == ("option --set penalty", 7.0)
    found = problem_of("vertical-rig", damping=0.3)
    assert unnamed(found.source, "damping", 0.3) == []


def test_stated_weights_are_the_robots_problem_at_the_goal(robot_of: Named, problem_of: Games) -> None:
    game = problem_of("paper", goal=(np.pi / 2,))
    problem = robot_of("paper").problem(pose=[np.pi / 2])
    assert game.gamma_star == pytest.approx(fh.smallest_gamma(problem), rel=1e-8)
    assert game.gamma == pytest.approx(1.5 * game.gamma_star)
    assert game.problem is game.nominal
    assert (game.target, game.search, game.robustness) == (None, None, None)
    assert game.nominal.operating_input == pytest.approx(problem.operating_input)


@pytest.mark.ci("searches weights")
def test_a_robot_without_a_penalty_gets_the_papers_form(robot_of: Named) -> None:
    """Positions and their integrals alone, each joint's own: a stable loop about its bandwidth."""
    robot = replace(robot_of("planar-two-link"), penalty=None)
    goal = np.array(robot.home)
    game = choose(robot, goal, goal - 0.1, Specification(preset="paper"))
    assert set(game.penalty.states) == {"link_position", "link_position_integral"}
    assert game.source.startswith("ours")
    gain = fh.solve_hji(game.problem, game.gamma, 2).gain
    assert np.linalg.eigvals(closed_loop(game.problem, gain)).real.max() < 0.0


@pytest.mark.ci("searches weights")
@pytest.mark.parametrize(
    "name",
    [
        pytest.param(n, marks=[pytest.mark.nightly("seven links")] if n == "seven-link" else [])
        for n in sorted(fh.catalogue())
    ],
)
def test_every_robot_of_the_catalogue_gets_a_damped_loop_without_being_told_how(
    robot_of: Named, name: str
) -> None:
    robot = replace(robot_of(name), penalty=None)
    goal = np.array(robot.home)
    game = choose(robot, goal, goal - 0.1, Specification())
    assert game.preset == "damped"
    assert game.target is not None
    assert game.target.damping == DAMPING
    gain = fh.solve_hji(game.problem, game.gamma, 2).gain
    values = np.linalg.eigvals(closed_loop(game.problem, gain))
    pairs = values[values.imag > 0.0]
    assert values.real.max() < 0.0
    assert (-pairs.real / np.abs(pairs)).min() > DAMPING
    links = robot.plant().linearise(*robot.operating_point())[0]
    joints = len(goal)
    held = np.sqrt(np.linalg.eigvals(links[joints : 2 * joints, 2 * joints : 3 * joints]).real.min())
    assert game.target.bandwidth == pytest.approx(BANDWIDTH_FRACTION * held, rel=1e-9)


# Disturbances ---------------------------------------------------------------------------------------
TORQUES = ("link_torque", "motor_torque")
#: Goals at which several tests look at the same games.
ROBUST = {"paper": (np.pi / 2,), "quanser-rotflex": (0.3,), "cart": None, "planar-two-link": None}


@pytest.mark.ci("searches weights")
@pytest.mark.parametrize("preset", ["paper", "damped", "robust"])
@pytest.mark.parametrize(
    ("asked", "names"),
    [
        ({}, ["link_position_command"]),
        ({"disturbances": TORQUES}, [*TORQUES]),
        ({"disturbances": ("motor_torque",), "command": True}, ["link_position_command", "motor_torque"]),
    ],
)
def test_disturbances_are_those_asked_for(
    problem_of: Games, preset: str, asked: dict[str, Any], names: list[str]
) -> None:
    game = problem_of("paper", goal=ROBUST["paper"], preset=preset, **asked)
    assert list(game.nominal.disturbance_names) == names
    assert list(game.problem.disturbance_names)[: len(names)] == names
    assert (len(game.problem.disturbance_names) > len(names)) is (preset == "robust")
    assert fh.solve_hji(game.problem, game.gamma, 4).degree == 4


@pytest.mark.oracle
@pytest.mark.parametrize(
    ("name", "disturbances"),
    ci_and_night(
        "searches weights",
        [("paper", TORQUES), ("cart", None)],
        [("paper", None), ("cart", TORQUES), ("planar-two-link", None), ("planar-two-link", TORQUES)],
    ),
)
def test_the_game_of_the_search_is_the_game_that_is_solved(
    problem_of: Games, name: str, disturbances: tuple[str, ...] | None
) -> None:
    """Two routes to γ* and the gain: the search's matrices, and the expansion of the nonlinear problem."""
    for preset in ("damped", "robust"):
        asked = {} if disturbances is None else {"disturbances": disturbances}
        game = problem_of(name, goal=ROBUST[name], preset=preset, **asked)
        assert game.search is not None
        searched = game.search.chosen
        assert searched.gamma_star == pytest.approx(game.gamma_star, rel=3e-3)
        solution = fh.solve_hji(game.problem, game.gamma, 2)
        size = np.abs(solution.gain).max()
        assert solution.gain == pytest.approx(searched.design.gain, rel=0.02, abs=2e-3 * size)


# Robust ---------------------------------------------------------------------------------------------
TWO_LINKS = pytest.param("planar-two-link", marks=pytest.mark.nightly("channels of two links"))


@pytest.mark.ci("searches weights")
@pytest.mark.oracle
@pytest.mark.parametrize("name", ["paper", "quanser-rotflex", "cart", TWO_LINKS])
def test_the_law_that_is_solved_attains_its_level_for_every_robot_of_the_channels(
    robot_of: Named, problem_of: Games, name: str
) -> None:
    """The linear part of solve_hji's law, with Δ of a share of the tolerances, by python-control's norm."""
    control = pytest.importorskip("control")
    pytest.importorskip("slycot")
    game, robot, rng = (
        problem_of(name, goal=ROBUST[name], preset="robust"),
        robot_of(name),
        np.random.default_rng(7),
    )
    assert game.robustness is not None
    goal = game.nominal.operating_point[: len(robot.joint_names)]
    found = channels(robot, [goal, goal - 0.1])
    assert game.robustness.channels == len(found)
    gain = fh.solve_hji(game.problem, game.gamma, 2).gain
    e = game.nominal.expand(1)
    a, b, d, c = e.f_parts[1], e.g2_parts[0][:, :, 0], e.g1_parts[0][:, :, 0], e.h_parts[1]
    torques = robot.plant().linearise(*robot.operating_point(goal))[2]
    z = np.vstack([c, np.linalg.cholesky(game.nominal.r2).T @ gain])
    norms = []
    for k in range(20):
        loop = a + b @ gain
        for channel in found:
            delta = game.robustness.fraction * (rng.choice([-1.0, 1.0]) if k % 2 else rng.uniform(-1.0, 1.0))
            seen = np.append(channel.by_state, np.zeros(len(goal))) + channel.by_input @ gain
            loop[: -len(goal)] += delta * np.outer(torques @ channel.torque, seen)
        assert np.linalg.eigvals(loop).real.max() < 0.0
        norms.append(control.linfnorm(control.ss(loop, d, z, np.zeros((len(z), d.shape[1]))))[0])
    assert max(norms) <= game.gamma
    assert max(norms) > game.robustness.nominal_gamma_star


@pytest.mark.ci("searches weights")
@pytest.mark.oracle
@pytest.mark.parametrize("name", ["paper", "quanser-rotflex", "cart", TWO_LINKS])
def test_what_robustness_costs_is_the_norm_of_two_loops_of_the_nominal_robot(
    problem_of: Games, name: str
) -> None:
    control = pytest.importorskip("control")
    pytest.importorskip("slycot")
    game = problem_of(name, goal=ROBUST[name], preset="robust")
    told = game.robustness
    assert told is not None
    star = fh.smallest_gamma(game.nominal)
    assert told.nominal_gamma_star == pytest.approx(star, rel=2e-3)
    assert told.gamma_star == game.gamma_star
    e = game.nominal.expand(1)
    a, b, d, c = e.f_parts[1], e.g2_parts[0][:, :, 0], e.g1_parts[0][:, :, 0], e.h_parts[1]

    def norm(gain: np.ndarray) -> float:
        z = np.vstack([c, np.linalg.cholesky(game.nominal.r2).T @ gain])
        return control.linfnorm(control.ss(a + b @ gain, d, z, np.zeros((len(z), d.shape[1]))))[0]

    plain, robust = fh.solve_hji(game.nominal, 1.5 * star, 2), fh.solve_hji(game.problem, game.gamma, 2)
    assert told.nominal_gain == pytest.approx(norm(plain.gain), rel=4e-3)
    assert told.robust_gain == pytest.approx(norm(robust.gain), rel=4e-3)
    assert told.nominal_gain < told.robust_gain < game.gamma


@pytest.mark.ci("searches weights")
@pytest.mark.oracle
@pytest.mark.parametrize(("name", "away"), [("paper", 0.1), ("cart", 0.002)])
def test_the_nonlinear_law_dissipates_for_every_robot_of_the_channels_near_the_goal(
    robot_of: Named, problem_of: Games, name: str, away: float
) -> None:
    """V̇ ≤ ½ γ²|r|² − ½ |z|² with the robot's own rates, torques Δ t (c x + e u) added by hand; below γ* it breaks."""
    game, robot = problem_of(name, goal=ROBUST[name], preset="robust"), robot_of(name)
    assert game.robustness is not None
    plant, joints = robot.plant(), len(robot.joint_names)
    rest, held = game.nominal.operating_point[: plant.n], game.nominal.operating_input
    found = channels(robot, [rest[:joints], rest[:joints] - 0.1])
    solution = fh.solve_hji(game.problem, game.gamma, 4)
    size = 1.0 / np.sqrt(np.diag(solution.P))

    def largest(gamma: float) -> float:
        """Of (V̇ − supplied) / V over states with the links no further than that from the goal."""
        rng, over = np.random.default_rng(5), []
        for _ in range(300):
            x = size * rng.normal(size=len(size))
            x *= away * rng.uniform(0.1, 1.0) / np.abs(x[:joints]).max()
            u, slope = solution.law(x), solution.gradient(x)
            torque = sum(
                game.robustness.fraction * rng.choice([-1.0, 1.0])  # type: ignore[union-attr]
                * (c.by_state @ x[: plant.n] + c.by_input @ u) * c.torque
                for c in found
            )  # fmt: skip
            r = -slope[-joints:] / gamma**2 * rng.uniform(0.5, 1.5)  # about the worst command
            rate = np.append(plant.derivative(rest + x[: plant.n], held + u, torque), x[:joints] - r)
            h = game.nominal.fields(x[None])[3][0]
            supplied = 0.5 * (gamma**2 * r @ r - h @ h - u @ game.nominal.r2 @ u)
            over.append((slope @ rate - supplied) / solution.value(x))
        return max(over)

    assert largest(game.gamma) < 1e-6
    assert largest(0.5 * game.gamma) > 0.1


@pytest.mark.ci("searches weights")
def test_the_region_of_a_robust_law_is_sampled_and_not_empty(problem_of: Games) -> None:
    game = problem_of("paper", goal=ROBUST["paper"], preset="robust")
    solution = fh.solve_hji(game.problem, game.gamma, 4)
    check = solution.sampled_region(gamma=1.6 * game.gamma_star, rays=300)
    assert check.level > 0.0
    assert check.step_amplitude() > 0.3


def test_robust_needs_tolerances_that_matter(robot_of: Named, only_uncertain: Callable[..., Any]) -> None:
    for names in ((), ("inductance",)):
        robot = only_uncertain(robot_of("paper"), *names)
        with refused_with(InvalidInput, "'paper'", "tolerances") as refused:
            choose(robot, np.array([0.5]), np.array([0.0]), Specification(preset="robust"))
        assert "preset='damped'" in str(refused.value)


@pytest.mark.ci("searches of weights")
def test_a_default_damping_out_of_reach_yields_and_a_stated_one_is_refused(robot_of: Named) -> None:
    """A vibration of 51 Hz has three samples of 6 ms a period: no sampled law damps it as by default."""
    robot = robot_of("vertical-rig stiffness*100")
    goal = np.array(robot.home)
    default = Specification(preset="damped", period=6e-3)
    found = choose(robot, goal, goal - 0.1, default)
    assert found.target is not None
    assert found.target.damping < 0.05
    assert required_damping(default.damping, found.target) == 0.1  # what the running loop is judged by
    with refused_with(DampingOutOfReach, "damping", 0.2):
        choose(robot, goal, goal - 0.1, replace(default, damping=0.2))


@pytest.mark.ci("searches weights")
def test_a_behaviour_out_of_reach_is_refused_for_robust_too(robot_of: Named) -> None:
    for preset in ("damped", "robust"):
        with pytest.raises(InvalidInput, match="binds"):
            choose(
                robot_of("paper"), np.array([0.5]), np.array([0.0]), Specification(preset=preset, damping=0.9)
            )


@pytest.mark.nightly("seven links")
def test_seven_links_are_covered_in_part_or_in_whole_and_it_is_told(problem_of: Games) -> None:
    game = problem_of("seven-link", preset="robust")
    assert game.robustness is not None
    assert 0.0 < game.robustness.fraction <= 1.0
    assert game.robustness.channels > 50
    assert len(game.problem.disturbance_names) == 7 + 14  # commands, and no more torques than there are
    assert game.gamma == pytest.approx(1.5 * game.robustness.gamma_star)


@pytest.mark.ci("searches weights")
def test_robots_are_linearised_once_for_all_bandwidths(
    robot_of: Named, monkeypatch: pytest.MonkeyPatch
) -> None:
    made: list[int] = []
    whole = LinearFamily.of

    def counted(robot: Any, goal: Any, members: int = 32, **options: Any) -> LinearFamily:
        made.append(members)
        return whole(robot, goal, members, **options)

    monkeypatch.setattr(LinearFamily, "of", staticmethod(counted))
    robot, goal, start = robot_of("paper"), np.array([0.0]), np.array([0.1])
    first = choose(robot, goal, start, Specification(preset="damped"))
    assert first.target is not None
    slower = Specification(preset="damped", bandwidth=float(0.7 * first.target.bandwidth[0]))
    near = choose(robot, goal, start, slower, near=first)
    assert made == [32, 400]
    alone = choose(robot, goal, start, slower)
    assert near.target is not None
    assert alone.gamma_star == pytest.approx(near.gamma_star, rel=0.1)
