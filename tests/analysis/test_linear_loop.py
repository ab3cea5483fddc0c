"""The linear loop against small motions of the nonlinear one, and delays between samples against SciPy's integrator."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from tests.analysis.conftest import dense_system, filter_of

from flexhinf.analysis import EquilibriumLoop
from flexhinf.estimation import ConstantGainFilter
from flexhinf.hinf import HJISolution
from flexhinf.loop import Controller, Loop, Step
from flexhinf.robot import Robot

PERIOD = 1e-3
SMALL = 1e-7

# Fifteen loops that run once: 1.5 s instead of 2.1 s.
pytestmark = pytest.mark.usefixtures("unoptimised")


@pytest.mark.quick_cases(2)
@pytest.mark.oracle
@pytest.mark.parametrize(
    ("kind", "delay", "latency"),
    [(kind, delay, 0) for kind in (None, "ekf") for delay in (0, 1, 40)]
    + [("ekf", 0, 1), ("ekf", 0, 3), ("ekf", 2, 1)],
)
def test_small_motions_are_those_of_the_compiled_loop(
    two_link: Robot,
    two_link_law: HJISolution,
    kind: str | None,
    delay: int,
    latency: int,
) -> None:
    """From a small deviation, sample by sample, with the queue of the delay and the estimator at its gain."""
    plant, (x, _) = two_link.plant(), two_link.operating_point()
    filter = None if kind is None else filter_of(plant, x, kind)
    resting = EquilibriumLoop(two_link_law, filter, plant, PERIOD, delay=delay, latency=latency)
    linear = resting.linear()
    moved = SMALL * np.random.default_rng(2).normal(size=8)
    state, places = np.zeros(len(dense_system(linear).a)), resting.step.places
    state[:8] = moved
    memory = state[len(state) - resting.step.size :]
    assert resting.delay == delay + latency
    memory[places["position"]] = -moved[
        :2
    ]  # no interval lies behind the first sample: half of it takes half away
    estimator = None if filter is None else ConstantGainFilter(filter, resting.gain(filter.process_noise))
    loop = Loop(plant, Controller(two_link_law, estimator, PERIOD, latency=latency), delay=delay * PERIOD)
    run = loop.run(duration=1.0, initial_state=x + moved)
    matrix = dense_system(linear).a
    multipliers = resting.modes([{}]).multipliers[0]
    assert np.abs(np.linalg.eigvals(matrix)).max() == pytest.approx(np.abs(multipliers).max(), abs=1e-9)
    for k in range(1000):
        if k in (1, 50, 999):
            assert np.allclose(run.signals["state"][k] - x, state[:8], atol=1e-4 * np.abs(state[:8]).max())
        state = matrix @ state


@pytest.mark.oracle
@pytest.mark.parametrize("samples", [0.0, 0.3, 1.0, 2.75])
def test_an_input_between_samples(arm: Robot, cubic: HJISolution, samples: float) -> None:
    linear = EquilibriumLoop(cubic, None, arm.plant(inductance=True), PERIOD, 0.5).linear()
    j, phi, old, new = linear.sampled_plant(samples * PERIOD)
    assert j == int(samples)
    share, x = samples - j, np.random.default_rng(0).normal(size=5)
    before, after = np.array([1.5]), np.array([-0.5])
    for length, u in ((share, before), (1.0 - share, after)):
        if length:
            flow = lambda _, s, u=u: linear.a @ s + linear.b @ u  # noqa: E731
            end = solve_ivp(flow, (0.0, length * PERIOD), x, rtol=1e-12, atol=1e-14)
            x = end.y[:, -1]
    start = np.random.default_rng(0).normal(size=5)
    assert np.allclose(phi @ start + old @ before + new @ after, x, rtol=1e-9, atol=1e-12)


def test_delays_join_at_whole_samples(arm: Robot, cubic: HJISolution) -> None:
    linear = EquilibriumLoop(cubic, None, arm.plant(), PERIOD, 0.5).linear()
    radii = [np.abs(linear.system(d * PERIOD).multipliers).max() for d in (2.0 - 1e-6, 2.0, 2.0 + 1e-6)]
    assert radii[0] == pytest.approx(radii[1], abs=1e-7)
    assert radii[2] == pytest.approx(radii[1], abs=1e-7)


@pytest.mark.oracle
@pytest.mark.parametrize("moving", [False, True])
def test_a_command_moves_the_linear_loop_as_the_compiled_one(
    two_link: Robot, two_link_law: HJISolution, moving: bool
) -> None:
    """A small step of the shoulder's command: of the integral alone, or with state and input of its rest."""
    plant, (x, u) = two_link.plant(), two_link.operating_point()
    resting = EquilibriumLoop(two_link_law, None, plant, PERIOD, moving=moving)
    system = resting.linear().part("r", "q")
    state, response = np.zeros(len(system.a)), [np.zeros(2)]
    command = SMALL * np.array([1.0, 0.0])
    for _ in range(600):
        state = system.a @ state + system.b @ command
        response.append(system.c @ state)
    rest = two_link.operating_point(x[:2] + 1e-4 * np.array([1.0, 0.0]))
    there, here = np.concatenate(rest), np.concatenate([x, u])
    values = here + SMALL / 1e-4 * (there - here) if moving else x[:2] + command
    names = (*plant.states, *plant.inputs) if moving else plant.states[:2]
    reference = {name: Step(value, initial=value) for name, value in zip(names, values)}
    loop = Loop(plant, Controller(two_link_law, None, PERIOD, moving=moving))
    run = loop.run(reference, duration=0.65)
    # A held command acts in the interval after its sample; of a moving one the first error is not integrated.
    late = 0 if moving else 1
    for k in (300, 600):
        found = run.signals["state"][k + late, :2] - x[:2]
        assert np.allclose(found, response[k], atol=2e-3 * np.abs(response[k]).max())


def test_an_opened_loop_closes_to_the_sensitivity(two_link: Robot, two_link_law: HJISolution) -> None:
    linear = EquilibriumLoop(two_link_law, None, two_link.plant(), PERIOD).linear()
    for delay in (0.0, 1.4e-3):
        grid = np.array([1.0, 30.0, 700.0])
        opened = linear.opened(delay).response(grid)
        closed = linear.part("w", "u+w", delay).response(grid)
        assert np.allclose(closed, np.linalg.inv(np.eye(2) - opened), rtol=1e-7)
