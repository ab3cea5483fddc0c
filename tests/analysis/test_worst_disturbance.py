"""The worst disturbance: its gradient by differences, its limit for small motions, and γ as its bound."""

from __future__ import annotations

import math

import numpy as np
import pytest
from tests.analysis.conftest import filter_of
from tests.builders import linear_law
from tests.refusals import refused_with
from tests.tiers import ci_and_night

from flexhinf.analysis import DisturbanceSearch, worst_disturbance
from flexhinf.analysis.worst_disturbance import DisturbanceRuns, ZeroOrderHold, gradient, small_motions
from flexhinf.errors import InvalidInput
from flexhinf.hinf import HJISolution, smallest_gamma, solve_hji
from flexhinf.plant import GeneralisedPlant, Penalty
from flexhinf.robot import Robot

TORQUES = ("link_torque", "motor_torque")
WEIGHTS = {"link_position": 75, "link_velocity": 27, "motor_position": 90, "motor_velocity": 27}

# Twenty loops: 1.0 s instead of 1.7 s.
pytestmark = pytest.mark.usefixtures("unoptimised")


@pytest.fixture(scope="module")
def torques(arm: Robot) -> GeneralisedPlant:
    """The arm about 90°, disturbed by torques at link and motor."""
    penalty = Penalty(WEIGHTS | {"link_position_integral": 330}, effort=10)
    return arm.problem(penalty, pose=[math.pi / 2], command=None, disturbances=TORQUES)


@pytest.fixture(scope="module")
def quartic(torques: GeneralisedPlant) -> HJISolution:
    return solve_hji(torques, gamma=1.5 * smallest_gamma(torques), degree=4)


@pytest.fixture(scope="module")
def both(two_link: Robot) -> GeneralisedPlant:
    """Two links, disturbed by all torques and by the command."""
    return two_link.problem(disturbances=TORQUES)


@pytest.mark.quick_cases(2)
@pytest.mark.oracle
@pytest.mark.parametrize("kind", [None, "ekf", "observer"])
@pytest.mark.parametrize("command", [True, False])
def test_gradient_by_differences_of_the_arm(
    arm: Robot,
    cubic: HJISolution,
    torques: GeneralisedPlant,
    quartic: HJISolution,
    kind: str | None,
    command: bool,
) -> None:
    problem, law = (arm.problem(), cubic) if command else (torques, quartic)
    point = problem.operating_point[:4]
    estimator = None if kind is None else filter_of(arm.plant(), point, kind, period=0.01)
    runs = DisturbanceSearch(problem, law, estimator, 0.01, horizon=1.5).search_runs
    differs(runs, 0.3 * np.random.default_rng(0).normal(size=(151, runs.channels)), (0, 1, 37, 148, 149))


@pytest.mark.ci("compiles a search of two links")
@pytest.mark.oracle
def test_gradient_by_differences_of_two_links(
    two_link: Robot, both: GeneralisedPlant, two_link_law: HJISolution
) -> None:
    filter = filter_of(two_link.plant(), both.operating_point[:8], period=0.01)
    for estimator in (None, filter):
        runs = DisturbanceSearch(both, two_link_law, estimator, 0.01, horizon=0.5).search_runs
        assert runs.channels == 6
        scales = np.array([0.1, 0.1, 3.0, 3.0, 3.0, 3.0])
        differs(runs, scales * np.random.default_rng(0).normal(size=(51, 6)), (0, 20, 48))


def differs(runs: DisturbanceRuns, d: np.ndarray, samples: tuple[int, ...]) -> None:
    found = gradient(runs, d)
    assert found is not None
    for k in samples:
        for channel in range(runs.channels):
            step = np.zeros_like(d)
            step[k, channel] = 1e-4
            above, below = gradient(runs, d + step), gradient(runs, d - step)
            assert above is not None
            assert below is not None
            difference = (above[1] - below[1]) / 2e-4
            assert found[0][k, channel] == pytest.approx(
                difference, rel=1e-5, abs=1e-6 * np.abs(found[0]).max()
            )


@pytest.mark.oracle
def test_small_motions_have_the_norm_of_the_linear_design(
    torques: GeneralisedPlant, quartic: HJISolution
) -> None:
    """ẋ = (A + B2 K) x + B1 d, z = (C x, √R2 K x) in continuous time, for a short period."""
    part, k = torques.expand(1), quartic.law(1e-7 * np.eye(5)).T / 1e-7
    a, b1, b2, c = part.f_parts[1], part.g1_parts[0][..., 0], part.g2_parts[0][..., 0], part.h_parts[1]
    b1 = part.g1_parts[0].reshape(5, 2)
    z = np.vstack([c, math.sqrt(10.0) * k])
    norm = max(
        np.linalg.norm(z @ np.linalg.solve(1j * w * np.eye(5) - (a + b2 @ k), b1), 2)
        for w in np.geomspace(0.1, 30, 2000)
    )
    found = small_motions(DisturbanceRuns(torques, quartic, None, 2e-4, 1.0)).norm()[0]
    assert found == pytest.approx(norm, rel=1e-3)
    assert smallest_gamma(torques) < found < quartic.gamma


@pytest.mark.ci("compiles a loop of two links with its estimator")
@pytest.mark.oracle
def test_small_motions_are_those_of_a_run(
    two_link: Robot, both: GeneralisedPlant, two_link_law: HJISolution
) -> None:
    """z of the nonlinear loop with its estimator, for a small d on all channels at once."""
    filter = filter_of(two_link.plant(), both.operating_point[:8], period=5e-3)
    runs = DisturbanceSearch(both, two_link_law, filter, 5e-3, horizon=1.0).search_runs
    d = 1e-5 * np.random.default_rng(4).normal(size=(201, 6))
    x, u = runs.deviations(runs.run(d), d)
    system = small_motions(runs)
    h, root = both.expand(1).h_parts[1], np.linalg.cholesky(both.r2).T
    measured = np.hstack([x @ h.T, u @ root.T])
    state, expected = np.zeros(len(system.a)), []
    for row in d:
        expected.append(system.c @ state)
        state = system.a @ state + system.b @ row
    assert np.allclose(measured, expected, atol=1e-4 * np.abs(measured).max())


@pytest.mark.parametrize("degree", ci_and_night("three ascents of eight turns", [4], [2, 6]))
def test_no_disturbance_of_the_arm_attains_gamma_inside_its_region(
    torques: GeneralisedPlant, degree: int
) -> None:
    """Looks for a counterexample to the dissipation inequality, which would be a mistake in the synthesis or here."""
    star = smallest_gamma(torques)
    law = solve_hji(torques, gamma=1.5 * star, degree=degree)
    level = law.sampled_region(rays=500).level
    found = worst_disturbance(torques, law, level=level, horizon=8.0, turns=8, starts=3, seed=degree)
    assert found.largest_value <= level
    assert found.gain <= law.gamma
    # Not trivially: no law at all does better than γ* for small motions.
    assert found.gain > 0.97 * star
    assert found.largest_value > 0.05 * level


@pytest.mark.nightly(
    "a law of degree 4 of two links, its region, and two ascents; the arm has one link above"
)
def test_no_disturbance_of_two_links_attains_gamma(two_link: Robot) -> None:
    weights = {"link_position": 30, "link_velocity": 5, "motor_position": 20, "motor_velocity": 5}
    penalty = Penalty({**weights, "link_position_integral": 60})  # on every state: the margin is definite
    problem = two_link.problem(penalty, command=None, disturbances=TORQUES)
    star = smallest_gamma(problem)
    law = solve_hji(problem, gamma=1.5 * star, degree=4)
    check = law.sampled_region()
    assert check is not None
    level = check.level
    found = worst_disturbance(problem, law, level=level, horizon=4.0, turns=5, starts=2)
    assert found.largest_value <= level
    assert 0.97 * star < found.gain <= law.gamma


@pytest.mark.ci("80 steps of ascents")
def test_the_limit_of_small_energies_is_the_norm(torques: GeneralisedPlant, quartic: HJISolution) -> None:
    search = DisturbanceSearch(torques, quartic, None, 0.01, horizon=20.0)
    norm, start = search.small()
    for first in (start, search.random(5)):
        d = search.ascend(first, 1e-3, 40)
        assert d is not None
        found = search.attained(d)
        assert found.energy == pytest.approx(1e-3, rel=1e-9)
        assert 0.97 * norm < found.gain < 1.001 * norm


@pytest.mark.ci("an ascent over whole runs")
def test_ascent_climbs_and_the_loop_itself_is_judged(
    arm: Robot, torques: GeneralisedPlant, quartic: HJISolution
) -> None:
    """With a Kalman filter the search takes its stationary gain; what counts is the run with the filter."""
    filter = filter_of(arm.plant(), torques.operating_point[:4], "ukf", period=5e-3)
    search = DisturbanceSearch(torques, quartic, filter, 5e-3, horizon=4.0)
    start = search.scaled(search.random(1), 2000.0)
    d = search.ascend(start, 2000.0, 6)
    assert d is not None
    assert search.attained(d).gain > 1.05 * search.attained(start).gain
    assert search.runs.loop.controller.estimator is filter
    assert search.search_runs.loop.controller.estimator is not filter
    assert (search.runs.loop.channel.delay, search.search_runs.loop.channel.delay) == (1, 0)


def test_a_disturbance_too_large_diverges(arm: Robot) -> None:
    """A cubic law that pushes the wrong way far out; the search says so."""
    problem = arm.problem()
    law = solve_hji(problem, gamma=1.05 * smallest_gamma(problem), degree=4)
    found = worst_disturbance(problem, law, energy=1e6, horizon=5.0, turns=2, starts=1)
    assert math.isinf(found.gain)
    assert math.isinf(found.largest_value)
    assert len(found.trajectory.time) < len(found.times)


def test_held_samples() -> None:
    signal = ZeroOrderHold(np.array([0.0, 0.1, 0.2]), np.array([1.0, 2.0, 3.0]))
    assert np.array_equal(
        signal(np.array([0.0, 0.0999, 0.1, 0.15, 0.2, 9.0])), [1.0, 1.0, 2.0, 2.0, 3.0, 3.0]
    )


def test_misuse_is_refused(arm: Robot, torques: GeneralisedPlant, quartic: HJISolution) -> None:
    for sizes in ({}, {"energy": 1.0, "level": 1.0}, {"energy": -1.0}, {"level": math.inf}):
        with pytest.raises(
            InvalidInput, match=f"energy={sizes.get('energy')} and level={sizes.get('level')}"
        ):
            worst_disturbance(torques, quartic, **sizes)  # type: ignore[arg-type]
    plain = linear_law(arm.plant(), np.ones(5), integrals=("link_position",))
    with refused_with(InvalidInput, "level=1.0", "LinearLaw"):
        worst_disturbance(torques, plain, level=1.0)
    with refused_with(InvalidInput, "states", "'link_position_integral'"):
        worst_disturbance(torques, linear_law(arm.plant(), np.ones(4)), energy=1.0)
    with refused_with(InvalidInput, "search_period=0.001 s", 0.01):
        DisturbanceSearch(torques, quartic, filter_of(arm.plant(), np.zeros(4)), 1e-3, search_period=0.01)


def test_no_command_leaves_the_joints_limits(two_link: Robot) -> None:
    """The search asked its own loop for a command beyond the joint's limit, and a whole design failed."""
    problem = two_link.problem(pose=[1.5, 0.0])
    law = solve_hji(problem, gamma=1.5 * smallest_gamma(problem), degree=2)
    limits = problem.plant.limits
    found = worst_disturbance(problem, law, energy=200.0, horizon=4.0, turns=2, starts=1)
    commands = problem.operating_point[:2] + found.disturbance
    low, high = np.array([limits[name] for name in problem.plant.states[:2]]).T
    assert np.all((commands >= low - 1e-12) & (commands <= high + 1e-12))
    assert np.any(
        (np.abs(commands - low) < 1e-9) | (np.abs(commands - high) < 1e-9)
    )  # it would have gone beyond
    assert 0.0 < found.energy < 200.0
    assert found.energy == pytest.approx(1e-3 * (found.disturbance[:-1] ** 2).sum())
