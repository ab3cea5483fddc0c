"""Loops whose input is late: closed forms, a second way to assemble them, and what a queue returns."""

from __future__ import annotations

import math

import numpy as np
import pytest
from tests.analysis.conftest import dense_system, designed, filter_of
from tests.builders import linear_law

from flexhinf.analysis import EquilibriumLoop, frequency_response, margins
from flexhinf.analysis.linear_loop import BRIEF, ECHO, DiscreteSystem, with_queue
from flexhinf.hinf import HJISolution
from flexhinf.plant import Plant
from flexhinf.robot import Robot, load_robot

PERIOD = 1e-3

# Loops that are linearised once, one of them of seven links: 3 s instead of 14 s.
pytestmark = pytest.mark.usefixtures("unoptimised")


def delayed(a: np.ndarray, e: np.ndarray, k: np.ndarray, samples: int) -> DiscreteSystem:
    """x⁺ = a x + e v, v(i) = k x(i − samples), without inputs and outputs."""
    matrix = with_queue(a[None], e[None], k[None], samples)[0]
    none = np.zeros((len(matrix), 0))
    return DiscreteSystem(matrix, none, none.T, np.zeros((0, 0)), PERIOD, samples, samples * e.shape[1])


@pytest.mark.quick_cases(3)
@pytest.mark.oracle
@pytest.mark.parametrize("delay", [0, 1, 5, 30, 200])
def test_figures_are_those_of_a_loop_assembled_otherwise(arm: Robot, cubic: HJISolution, delay: int) -> None:
    filter = filter_of(arm.plant(), np.zeros(4))
    linear = EquilibriumLoop(cubic, filter, arm.plant(), PERIOD, 1.0, delay=delay, latency=0).linear()
    dense, found = dense_system(linear), linear.closed_loop
    grid = np.array([0.0, 0.3, 5.0, 14.0, 80.0, 700.0, np.pi / PERIOD])
    expected = dense.response(grid)
    assert np.allclose(found.response(grid), expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())
    assert found.stable == dense.stable
    if not found.stable:
        return
    for into, rows, columns in (("w", slice(0, 1), slice(0, 1)), ("v", slice(1, 2), slice(1, 2))):
        one, other = linear.part(into, "u+w" if into == "w" else "u"), dense.block(rows, columns)
        assert one.rms() == pytest.approx(other.rms(), rel=1e-9)
        norm, at = one.norm()
        fine = np.concatenate([np.geomspace(0.1, np.pi / PERIOD, 500), at * np.linspace(0.99, 1.01, 11)])
        swept = np.abs(one.response(fine)).max()
        assert swept * (1.0 - 1e-9) <= norm <= swept * (1.0 + 1e-9)


@pytest.mark.oracle
def test_a_first_order_loop_is_on_its_edge_where_theory_says() -> None:
    """x⁺ = x − g x(i − q) is stable up to g = 2 sin(π/(2 (2q + 1))), at z = e^{jπ/(2q + 1)}."""
    one = np.ones((1, 1))
    for samples in (1, 7, 200):
        edge = 2.0 * math.sin(math.pi / (2.0 * (2 * samples + 1)))
        below, above = (delayed(one, one, -factor * edge * one, samples) for factor in (0.9999, 1.0001))
        assert below.stable
        assert int((np.abs(above.multipliers) > 1.0).sum()) == 2
        top = delayed(one, one, -edge * one, samples).modes()[0][:2]
        assert np.abs(top) == pytest.approx(1.0, abs=1e-9)
        assert np.abs(np.angle(top)) == pytest.approx(math.pi / (2 * samples + 1), rel=1e-7)


@pytest.mark.oracle
def test_modes_that_count_are_roots_of_the_characteristic_equation() -> None:
    """det(zI − a − z^-q e k) = 0: several inputs, unstable loops, modes that no input moves; their vectors solve it."""
    rng = np.random.default_rng(3)
    for _ in range(60):
        n, samples = int(rng.integers(1, 12)), int(rng.integers(1, 40))
        m = int(rng.integers(1, min(n, 3) + 1))
        a = rng.normal(size=(n, n))
        a *= rng.uniform(0.3, 1.05) / np.abs(np.linalg.eigvals(a)).max()
        e, k = rng.normal(size=(n, m)), rng.normal(size=(m, n)) * 10.0 ** rng.uniform(-3.0, 0.5)
        system = delayed(a, e, k, samples)
        values, vectors = system.modes()
        for z, vector in zip(values, vectors.T, strict=True):
            late = z ** -float(samples) * (e @ k)
            size = abs(z) + np.linalg.norm(a) + np.linalg.norm(late)
            error = z * vector - a @ vector - late @ vector
            assert np.linalg.norm(error) <= 1e-7 * size * np.linalg.norm(vector)
        loud = system.multipliers[np.abs(system.multipliers) > BRIEF]
        assert np.isin(loud[np.abs(loud) ** samples >= ECHO], values).all()


def test_what_lasts_in_a_loop_with_a_short_queue_is_no_echo() -> None:
    """The poles of up to four samples of delay, which need no eigenvectors, are those that `modes` finds with them."""
    rng = np.random.default_rng(5)
    for samples in (1, 2, 4, 5) * 5:
        a, e, k = rng.normal(size=(5, 5)), rng.normal(size=(5, 2)), rng.normal(size=(2, 5))
        system = delayed(0.9 * a / np.abs(np.linalg.eigvals(a)).max(), e, 0.3 * k, samples)
        expected = system.period * system.poles
        found = np.log(system.modes()[0])
        assert np.sort(found.real) == pytest.approx(np.sort(expected.real), abs=1e-9)
        assert np.sort(found.imag) == pytest.approx(np.sort(expected.imag), abs=1e-9)


def soft(gain: float, delay: int) -> EquilibriumLoop:
    """A damped oscillator under weak feedback, which stands any delay."""
    plant = Plant(
        lambda x, u, d, p: np.array([x[1], -p.k * x[0] - p.c * x[1] + u[0] + d[0]]),
        lambda x, u, p: np.array([x[0]]),
        states=("position", "velocity"), inputs=("force",), disturbances=("push",), parameters={"k": 4.0, "c": 2.0},
    )  # fmt: skip
    law = linear_law(plant, [-gain, -0.3])
    rest = (np.zeros(2), np.zeros(1))
    return EquilibriumLoop(law, None, plant, PERIOD, equilibrium=rest, delay=delay, positions="position")


@pytest.mark.oracle
def test_a_delay_of_two_hundred_samples_by_closed_forms() -> None:
    """Responses by 1/(1 + z^-q L), the peak by a fine sweep, noise by the impulse response."""
    delay = 200
    linear = soft(1.0, delay).linear()
    found, shown = margins(linear), frequency_response(linear, np.array([0.1, 1.0, 2.0, 5.0, 40.0]))
    assert found.stable
    opened = linear.opened(0.0).response(shown.frequencies)[:, 0, 0]
    late = np.exp(-1j * shown.frequencies * PERIOD * delay)
    assert np.allclose(shown.sensitivity[:, 0, 0], 1.0 / (1.0 - late * opened), rtol=1e-9)
    grid = np.linspace(0.01, 40.0, 40_001)
    opened = linear.opened(0.0).response(grid)[:, 0, 0] * np.exp(-1j * grid * PERIOD * delay)
    peak = np.abs(1.0 / (1.0 - opened)).max()
    assert peak * (1.0 - 1e-9) <= found.peak_sensitivity <= peak * (1.0 + 1e-6)
    running = linear.part("v", "u")
    power, total = running.a, running.b[:, :1] @ running.b[:, :1].T
    for _ in range(15):  # 2^15 samples
        total = total + power @ total @ power.T
        power = power @ power
    expected = running.d[0, 0] ** 2 + (running.c @ total @ running.c.T).item()
    assert found.noise_to_input[0, 0] == pytest.approx(math.sqrt(expected), rel=1e-9)


def test_echoes_are_no_oscillations() -> None:
    """Of 0.2 s of delay every frequency comes back; less than a tenth of it does not count."""
    running = soft(0.3, 200).linear().closed_loop
    assert running.stable
    assert running.damping[0] > 0.25
    assert (np.abs(running.multipliers) > BRIEF).sum() > 2 * len(running.poles)


def test_a_delay_margin_beyond_the_longest_queue_is_that_of_the_crossing() -> None:
    """Where the queue would have more than 200 samples the crossing itself is the margin: here by the closed form."""
    linear = soft(4.5, 0).linear()
    margin, frequency = margins(linear).delay_margin_s, margins(linear).delay_frequency
    assert margin > 200 * PERIOD
    answer = linear.opened(0.0).response(np.array([frequency]))[0, 0, 0]
    assert abs(answer * np.exp(-1j * frequency * margin) - 1.0) <= 1e-6


@pytest.mark.ci("a law and a loop of seven links")
@pytest.mark.oracle
@pytest.mark.parametrize("delay", [10, 60])
def test_seven_joints(delay: int) -> None:
    """Clusters of poles, seven inputs: those that count are those of a loop that is assembled otherwise."""
    robot = load_robot("seven-link")
    law, (x, _) = designed(robot, degree=2), robot.operating_point()
    linear = EquilibriumLoop(
        law, filter_of(robot.plant(), x), robot.plant(), PERIOD, delay=delay, latency=0
    ).linear()
    values = dense_system(linear).multipliers
    assert linear.closed_loop.stable == (np.abs(values).max() < 1.0)
    large = values[(np.abs(values) > BRIEF) & (np.abs(values) ** delay >= ECHO)]
    apart = np.abs(np.subtract.outer(large, linear.closed_loop.modes()[0])).min(axis=1)
    assert apart.max() < 1e-6
