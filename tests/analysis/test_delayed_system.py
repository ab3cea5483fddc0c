"""A queue as a factor z^-q against a state for each input that waits, closed forms, and delays of seconds."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest

from flexhinf.analysis import EquilibriumLoop, frequency_response, margins
from flexhinf.analysis import delayed_poles as module
from flexhinf.analysis.delayed_poles import BRIEF, ECHO, DelayedPoles, OneDelayedLoop
from flexhinf.analysis.delayed_system import DelayedSystem
from flexhinf.hinf import HJISolution
from flexhinf.plant import Plant
from flexhinf.robot import Robot, load_robot

PERIOD = 1e-3


def unrolled(a: np.ndarray, e: np.ndarray, k: np.ndarray, samples: int) -> np.ndarray:
    """With a state for each input that waits, newest first."""
    (n, m), queued = e.shape, samples * e.shape[1]
    matrix = np.zeros((n + queued, n + queued))
    matrix[:n, :n], matrix[:n, n + queued - m :] = a, e
    matrix[n : n + m, :n], matrix[n + m :, n : n + queued - m] = k, np.eye(queued - m)
    return matrix


@pytest.fixture
def searched(monkeypatch: pytest.MonkeyPatch) -> None:
    """Roots are searched for also where the queue is short."""
    monkeypatch.setattr(module, "FEW", 0)
    monkeypatch.setattr(module, "SHORT", 0)
    monkeypatch.setattr(module, "LAST_RESORT", 0)


@pytest.mark.oracle
@pytest.mark.parametrize("delay", [0, 1, 5, 30])
def test_figures_are_those_with_a_state_for_each_waiting_input(
    searched: None, made: SimpleNamespace, arm: Robot, cubic: HJISolution, delay: int
) -> None:
    filter = made.filter(arm.plant(), np.zeros(4))
    linear = EquilibriumLoop(cubic, filter, arm.plant(), PERIOD, 1.0, delay=delay).linear()
    assert isinstance(linear.running, DelayedSystem) == bool(delay)
    dense, found = made.dense_system(linear), linear.running
    grid = np.array([0.0, 0.3, 5.0, 14.0, 80.0, 700.0, np.pi / PERIOD])
    expected = dense.response(grid)
    assert np.allclose(found.response(grid), expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())
    assert found.stable == dense.stable
    assert found.damping == pytest.approx(dense.damping, rel=1e-9)
    for into, rows, columns in (("w", slice(0, 1), slice(0, 1)), ("v", slice(1, 2), slice(1, 2))):
        one, other = linear.part(into, "u+w" if into == "w" else "u"), dense.block(rows, columns)
        assert one.norm()[0] == pytest.approx(other.norm()[0], rel=5e-9)
        assert one.rms() == pytest.approx(other.rms(), rel=1e-9)


@pytest.mark.oracle
def test_roots_of_random_loops_are_eigenvalues_and_all_of_them(searched: None) -> None:
    """Several inputs, unstable ones, fast ones, modes that no input moves; echoes as eigenvectors tell them."""
    rng = np.random.default_rng(3)
    for trial in range(60):
        n, samples = int(rng.integers(1, 12)), int(rng.integers(1, 40))
        m = int(rng.integers(1, min(n, 3) + 1))
        a = rng.normal(size=(n, n))
        a *= rng.uniform(0.3, 1.05) / np.abs(np.linalg.eigvals(a)).max()
        if trial % 7 == 0 and n % 2 == 0:
            a = np.kron(np.eye(n // 2), [[1.0, 0.01], [0.0, 1.0]])
        e, k = rng.normal(size=(n, m)), rng.normal(size=(m, n)) * 10.0 ** rng.uniform(-3.0, 0.5)
        loop = OneDelayedLoop(a, e, k, samples)
        values, right = np.linalg.eig(unrolled(a, e, k, samples))
        found = loop.multipliers()
        for z in values[(np.abs(values) > BRIEF) & (np.abs(values) ** samples >= ECHO)]:
            assert np.abs(found - z).min() <= 2e-8 if trial % 7 else np.abs(found - z).min() <= 1e-4
        if trial % 7:
            queued = np.abs((right * np.linalg.inv(right).T)[n:].sum(axis=0))
            own = (np.abs(values) > BRIEF) & ((np.abs(values) ** samples >= ECHO) | (queued <= 0.5))
            assert len(found) == own.sum()
            assert loop.outside(1.0) == int((np.abs(values) > 1.0).sum())


@pytest.mark.oracle
def test_a_first_order_loop_is_on_its_edge_where_theory_says() -> None:
    """x⁺ = x − g x(i − q) is stable up to g = 2 sin(π/(2 (2q + 1))), at z = e^{jπ/(2q + 1)}."""
    one = np.ones((1, 1))
    for samples in (1, 7, 300, 1500):
        edge = 2.0 * math.sin(math.pi / (2.0 * (2 * samples + 1)))
        below, above = (
            OneDelayedLoop(one, one, -factor * edge * one, samples) for factor in (0.9999, 1.0001)
        )
        assert below.outside(1.0) == 0
        assert above.outside(1.0) == 2
        top = OneDelayedLoop(one, one, -edge * one, samples).multipliers()[:2]
        assert np.abs(top) == pytest.approx(1.0, abs=1e-10)
        assert np.abs(np.angle(top)) == pytest.approx(math.pi / (2 * samples + 1), rel=1e-8)


@pytest.mark.oracle
@pytest.mark.parametrize("few", [48, 0])
@pytest.mark.parametrize("samples", [3, 45])
def test_the_largest_of_many_loops(monkeypatch: pytest.MonkeyPatch, few: int, samples: int) -> None:
    """Followed from one to the next, and counted; also where the eigenvalues of the long matrix take less time."""
    monkeypatch.setattr(module, "FEW", few)
    monkeypatch.setattr(module, "SHORT", 0)
    rng = np.random.default_rng(5)
    middle = np.array([[0.99, 0.05, 0.0], [-0.05, 0.98, 0.02], [0.0, 0.0, 0.9]])
    a = middle * (1.0 + 0.02 * rng.normal(size=(40, 3, 3)))
    e, k = rng.normal(size=(3, 2)) + 0.1 * rng.normal(size=(40, 3, 2)), 0.02 * rng.normal(size=(40, 2, 3))
    found = np.abs(DelayedPoles(a, e, k, samples).largest()).max(axis=1)
    expected = [np.abs(np.linalg.eigvals(unrolled(*row, samples))).max() for row in zip(a, e, k, strict=True)]
    assert found == pytest.approx(expected, rel=1e-9)


def soft(made: SimpleNamespace, gain: float, delay: int) -> EquilibriumLoop:
    """A damped oscillator under weak feedback, which stands any delay."""
    plant = Plant(
        lambda x, u, d, p: np.array([x[1], -p.k * x[0] - p.c * x[1] + u[0] + d[0]]),
        lambda x, u, p: np.array([x[0]]),
        states=("position", "velocity"), inputs=("force",), disturbances=("push",), parameters={"k": 4.0, "c": 2.0},
    )  # fmt: skip
    law = made.Gains(plant, [[gain, 0.3]], np.zeros(2), np.zeros(1))
    rest = (np.zeros(2), np.zeros(1))
    return EquilibriumLoop(law, None, plant, PERIOD, equilibrium=rest, delay=delay, positions="position")


@pytest.mark.oracle
@pytest.mark.parametrize("delay", [1000, pytest.param(10_000, marks=pytest.mark.slow)])
def test_delays_of_seconds(made: SimpleNamespace, delay: int) -> None:
    """Responses by the closed form 1/(1 + L), noise by the impulse response, peaks by a fine sweep."""
    linear = soft(made, 1.0, delay).linear()
    found, shown = margins(linear), frequency_response(linear, np.array([0.1, 1.0, 2.0, 5.0, 40.0]))
    assert found.stable
    z = np.exp(1j * shown.frequencies * PERIOD)
    opened = linear.opened(0.0).response(shown.frequencies)[:, 0, 0] * z ** -float(delay)
    assert np.allclose(shown.sensitivity[:, 0, 0], 1.0 / (1.0 - opened), rtol=1e-9)
    grid = np.linspace(0.01, 40.0, 200_001)
    opened = linear.opened(0.0).response(grid)[:, 0, 0] * np.exp(-1j * grid * PERIOD * delay)
    peak = np.abs(1.0 / (1.0 - opened)).max()
    assert peak * (1.0 - 1e-9) <= found.peak_sensitivity <= peak * (1.0 + 1e-3)
    running = linear.part("v", "u")
    # White noise through the loop: the squares of its impulse response, with a ring of inputs.
    x, ring, total = running.b[:, :1], np.zeros(delay), float(running.d[0, 0] ** 2)
    ring[0] = running.fed[0, 0]
    for i in range(1, 20 * delay if delay <= 1000 else 1):
        total += float((running.c @ x).item() ** 2)
        late = ring[i % delay] if i >= delay else 0.0
        ring[i % delay] = (running.k @ x).item()
        x = running.a @ x + running.e * late
    if delay <= 1000:
        assert found.noise_to_input[0, 0] == pytest.approx(math.sqrt(total), rel=1e-9)
    assert np.abs(linear.running.multipliers).min() > BRIEF
    assert len(linear.running.multipliers) < 40


def test_echoes_are_no_oscillations(made: SimpleNamespace) -> None:
    """Of 1 s of delay every frequency comes back; less than a tenth of it does not count."""
    running = soft(made, 0.3, 1000).linear().running
    assert running.stable
    assert running.damping[0] > 0.25
    loop = OneDelayedLoop(running.a, running.e, running.k, 1000)
    assert loop.outside(0.02 ** (1.0 / 1000)) > len(running.multipliers)


@pytest.mark.slow
@pytest.mark.oracle
@pytest.mark.parametrize("delay", [10, 60])
def test_seven_joints(made: SimpleNamespace, delay: int) -> None:
    """Clusters of poles, seven inputs: the smallest damping and the count are those of the long matrix."""
    robot = load_robot("seven-link")
    law, (x, _) = made.law(robot, degree=2), robot.operating_point()
    linear = EquilibriumLoop(law, made.filter(robot.plant(), x), robot.plant(), PERIOD, delay=delay).linear()
    values = made.dense_system(linear).multipliers
    assert linear.running.stable == (np.abs(values).max() < 1.0)
    assert linear.running._loop.outside(0.995) == (np.abs(values) > 0.995).sum()
    large = values[(np.abs(values) > BRIEF) & (np.abs(values) ** delay >= ECHO)]
    apart = np.abs(np.subtract.outer(large, linear.running.multipliers)).min(axis=1)
    assert apart.max() < 1e-6
