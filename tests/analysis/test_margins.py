"""Margins against closed forms, python-control, brute force and runs of the nonlinear loop."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from tests.analysis.conftest import dense_opened, dense_system, filter_of
from tests.builders import linear_law
from tests.refusals import refused_with

import flexhinf as fh
from flexhinf.analysis import DiscreteSystem, EquilibriumLoop, LinearLoop, margins
from flexhinf.analysis.margins import COARSE, _gain_margins
from flexhinf.analysis.search import crossings, highest_peak
from flexhinf.errors import InvalidInput
from flexhinf.estimation import ConstantGainFilter
from flexhinf.hinf import HJISolution
from flexhinf.loop import Controller, Loop
from flexhinf.plant import Plant
from flexhinf.robot import Robot

PERIOD = 1e-3

# Two dozen loops, most of them linearised once: 1.7 s instead of 2.2 s.
pytestmark = pytest.mark.usefixtures("unoptimised")


def mass(stiffness: float, damping: float, period: float, delay: int = 0) -> EquilibriumLoop:
    """A unit mass on PD: q̈ = u."""
    plant = Plant(
        lambda x, u, d, p: np.array([x[1], u[0]]),
        lambda x, u, p: x[:1],
        states=("position", "velocity"),
        inputs=("force",),
    )
    law = linear_law(plant, [-stiffness, -damping])
    return EquilibriumLoop(law, None, plant, period, moving=True, delay=delay, positions="position")


@pytest.mark.oracle
def test_a_mass_on_pd_has_the_margins_of_the_textbook() -> None:
    """L = (d s + k)/s²: crossover, phase margin less half a period of the hold, and the poles' bandwidth."""
    k, d, period = 100.0, 8.0, 1e-5
    found = margins(mass(k, d, period))
    crossover = math.sqrt((d**2 + math.sqrt(d**4 + 4.0 * k**2)) / 2.0)
    delay = math.atan2(d * crossover, k) / crossover - period / 2.0
    assert found.delay_margin_s == pytest.approx(delay, rel=1e-4)
    assert found.delay_frequency == pytest.approx(crossover, rel=1e-4)
    grid = np.linspace(1.0, 60.0, 200_001)
    peak = (grid**2 / np.abs(-(grid**2) + d * 1j * grid + k)).max()
    assert found.peak_sensitivity == pytest.approx(peak, rel=1e-4)
    a = 2.0 * k - d**2
    assert found.bandwidth[0] == pytest.approx(math.sqrt((a + math.sqrt(a**2 + 4.0 * k**2)) / 2.0), rel=1e-4)
    assert found.positions == ("position",)


@pytest.mark.parametrize(("size", "upper"), [(1e-3, 1.5e3), (1e-9, math.inf), (1e-60, math.inf)])
def test_a_gain_margin_beyond_a_million_is_infinite(size: float, upper: float) -> None:
    """Old code showed the rounding of a loop that is hardly there as a factor with 60 digits."""
    one = np.ones((1, 1))
    opened = DiscreteSystem(0.5 * one, -size * one, one, 0.0 * one, PERIOD)
    grid = opened.frequencies()

    def factors(frequency: np.ndarray) -> np.ndarray:
        return 1.0 / opened.response(frequency)[:, :, 0]

    found = _gain_margins(factors, grid, factors(grid), math.pi / PERIOD, 1e-12)
    assert found[0].tolist() == [0.0, pytest.approx(upper)]


@pytest.mark.oracle
def test_the_gain_of_an_unstable_plant_must_not_fall() -> None:
    """ẋ = x + u with u = −3 x is unstable below a third of the gain, at ω = 0: old code knew no such factor."""
    plant = Plant(
        lambda x, u, d, p: np.array([x[0] + u[0]]), lambda x, u, p: x, states=("level",), inputs=("flow",)
    )
    law = linear_law(plant, [-3.0])
    found = margins(EquilibriumLoop(law, None, plant, 0.01, positions="level"))
    growth = math.exp(0.01)
    assert found.gain_margins[0] == pytest.approx([1.0 / 3.0, (growth + 1.0) / (growth - 1.0) / 3.0])
    assert found.gain_margin == pytest.approx(3.0)


@pytest.mark.oracle
def test_a_peak_and_a_zero_are_refined_to_the_last_digits() -> None:
    """A resonance of 0.1 % damping between points 8 % apart: 1/(2 ζ √(1 − ζ²)) at √(1 − 2 ζ²)."""
    zeta, grid = 1e-3, np.geomspace(0.01, 100.0, 120)
    counted: list[int] = []

    def size(w: np.ndarray) -> np.ndarray:
        counted.append(len(w))
        return 1.0 / np.abs(1.0 - w**2 + 2j * zeta * w)

    peak, at = highest_peak(size, grid)
    assert peak == pytest.approx(1.0 / (2.0 * zeta * math.sqrt(1.0 - zeta**2)), rel=1e-12)
    assert at == pytest.approx(math.sqrt(1.0 - 2.0 * zeta**2), rel=1e-7)
    assert sum(counted[1:]) < 30
    counted.clear()

    def branches(w: np.ndarray) -> np.ndarray:
        counted.append(len(w))
        return np.stack([np.sin(w), np.exp(w) - 2.0], axis=1)

    found = crossings(branches, np.linspace(0.05, 10.0, 40))
    assert len(counted) < 25  # 38 halvings would do
    zeros = [(0, math.pi), (0, 2.0 * math.pi), (0, 3.0 * math.pi), (1, math.log(2.0))]
    assert [branch for branch, _ in sorted(found)] == [branch for branch, _ in zeros]
    assert [w for _, w in sorted(found)] == pytest.approx([w for _, w in zeros], rel=1e-11)
    ((_, jump),) = crossings(lambda w: np.where(w < 0.37, -1.0, 1.0)[:, None], np.linspace(0.0, 2.0, 8))
    assert jump == pytest.approx(0.37, rel=1e-11)


@pytest.mark.oracle
def test_gain_margin_of_the_sampled_mass() -> None:
    """z² + (dT + kT²/2 − 2) z + 1 + kT²/2 − dT has a root at −1 when the gain is 2/(dT) times as large."""
    lower, upper = margins(mass(100.0, 8.0, 0.01)).gain_margins[0]
    assert upper == pytest.approx(2.0 / (8.0 * 0.01), rel=1e-9)
    assert lower == 0.0


@pytest.mark.ci("python-control interpolates 8,000 frequencies")
@pytest.mark.oracle
@pytest.mark.parametrize("kind", [None, "ukf"])
def test_one_input_as_python_control_sees_it(arm: Robot, cubic: HJISolution, kind: str | None) -> None:
    control = pytest.importorskip("control")
    filter = None if kind is None else filter_of(arm.plant(), np.zeros(4), kind)
    linear = EquilibriumLoop(
        cubic, filter, arm.plant(inductance=True), PERIOD, math.pi / 2, latency=0
    ).linear()
    found, opened = margins(linear), linear.opened()
    grid = np.geomspace(0.05, 0.999 * np.pi / PERIOD, 8_000)
    loop = control.ss(opened.a, opened.b, -opened.c, -opened.d, PERIOD)  # python-control's loops have a minus
    measured = control.FRD(loop(np.exp(1j * grid * PERIOD)), grid, smooth=True)
    gains, phases, _, _, at, _ = control.stability_margins(measured, returnall=True)
    lower, upper = found.gain_margins[0]
    above, below = [g for g in gains if g > 1.0], [g for g in gains if g < 1.0]
    assert upper == pytest.approx(min(above, default=math.inf), rel=1e-4)
    assert lower == pytest.approx(max(below, default=0.0), rel=1e-4)
    stable = [
        DiscreteSystem(
            opened.a + k * opened.b @ opened.c / (1.0 - k * opened.d[0, 0]),
            opened.b,
            opened.c,
            opened.d,
            PERIOD,
        ).stable
        for k in (0.99 * lower, 1.01 * lower, 0.99 * upper, 1.01 * upper)
    ]
    assert stable == [False, True, True, False]
    # At a crossover so far below the sampling frequency a delay is a phase.
    expected = min(math.radians(phase % 360.0) / w for phase, w in zip(phases, at, strict=True))
    assert found.delay_margin_s == pytest.approx(expected, rel=5e-3)


def first_unstable(linear: LinearLoop, longest: float, steps: int) -> float:
    """Of so many delays; of those before the first unstable hundredth only where it lies behind a stable one."""
    delays = np.linspace(0.0, longest, steps + 1)
    unstable = lambda k: np.abs(dense_system(linear, delays[k]).multipliers).max() >= 1.0  # noqa: E731
    part = steps // 100
    coarse = next((k for k in range(0, steps + 1, part) if unstable(k)), None)
    if coarse is None:
        return math.inf
    return float(delays[next(k for k in range(max(0, coarse - part), coarse + 1) if unstable(k))])


@pytest.mark.quick_cases(1)
@pytest.mark.oracle
@pytest.mark.parametrize(("stiffness", "damping", "period"), [
    (100.0, 8.0, 0.02), (100.0, 20.0, 0.04), (400.0, 30.0, 0.03), (3.0, 45.0, 0.02), (100.0, 3.0, 0.05),
])  # fmt: skip
def test_delays_of_few_samples_by_brute_force(stiffness: float, damping: float, period: float) -> None:
    """Where a period is a large part of the margin, hold and fraction matter."""
    linear = mass(stiffness, damping, period).linear()
    found = margins(linear).delay_margin_s
    expected = first_unstable(linear, 8.0 * period, 8000)
    assert found == pytest.approx(expected, abs=1.1e-3 * period)


@pytest.mark.ci("20,000 frequencies of a loop of two links")
@pytest.mark.oracle
@pytest.mark.parametrize("period", [2e-3, 1e-2])
def test_several_inputs_by_brute_force(two_link: Robot, two_link_law: HJISolution, period: float) -> None:
    plant = two_link.plant()
    filter = filter_of(plant, two_link.operating_point()[0], "ekf", period=period)
    linear = EquilibriumLoop(two_link_law, filter, plant, period, latency=0).linear()
    found = margins(linear)
    fine = found.delay_margin_s * np.array([0.0, 0.3, 0.6, 0.9, 0.99, 0.9999, 1.0001])
    radii = [np.abs(dense_system(linear, delay).multipliers).max() for delay in fine]
    assert [radius < 1.0 for radius in radii] == [True] * 6 + [False]
    grid = np.linspace(0.01, np.pi / period, 20_000)
    sizes = np.linalg.norm(linear.part("w", "u+w").response(grid), 2, axis=(1, 2))
    assert 0.999 * found.peak_sensitivity < sizes.max() <= found.peak_sensitivity * (1.0 + 1e-9)
    assert np.all((found.bandwidth > 1.0) & (found.bandwidth < 30.0))


@pytest.mark.ci("runs of 60 s")
@pytest.mark.oracle
@pytest.mark.parametrize("kind", [None, "ekf"])
def test_runs_on_both_sides_of_the_delay_margin(
    two_link: Robot, two_link_law: HJISolution, kind: str | None
) -> None:
    """Loop(delay=…) of the nonlinear loop: small motions die out one millisecond before it, and grow one behind."""
    plant, (x, _) = two_link.plant(), two_link.operating_point()
    filter = None if kind is None else filter_of(plant, x, kind)
    resting = EquilibriumLoop(two_link_law, filter, plant, PERIOD)
    found, sizes = margins(resting), []
    estimator: Any = None
    if filter is not None:
        estimator = ConstantGainFilter(filter, resting.gain(filter.process_noise))
    whole = math.floor(found.delay_margin_s / PERIOD)
    for samples in (whole - 1, whole + 2):
        loop = Loop(plant, Controller(two_link_law, estimator, PERIOD), delay=samples * PERIOD)
        run = loop.run(duration=60.0, initial_state=x + 1e-7)
        velocity = run.signal("state", "link_velocity_elbow")
        early, late = (np.abs(velocity[int(a * 1000) : int(b * 1000)]).max() for a, b in ((20, 30), (50, 60)))
        sizes.append(late / early)
    assert sizes[0] < 0.8 < 1.3 < sizes[1]


@pytest.mark.ci("a loop of each filter")
@pytest.mark.oracle
@pytest.mark.parametrize("kind", [pytest.param(None, marks=pytest.mark.ci("one more loop")), "ekf"])
def test_a_search_knows_the_delay_margin_up_to_what_it_needs(
    two_link: Robot, two_link_law: HJISolution, kind: str | None
) -> None:
    plant, (x, _) = two_link.plant(), two_link.operating_point()
    filter = None if kind is None else filter_of(plant, x, kind)
    found = margins(EquilibriumLoop(two_link_law, filter, plant, PERIOD))
    exact = found.delay_margin_s
    for share in (0.3, 0.999):
        assert found.delay_margin_within(share * exact) == share * exact
    for share in (1.001, 1.7):
        assert 0.0 <= exact - found.delay_margin_within(share * exact) <= COARSE * share * exact
    assert margins(mass(100.0, -1.0, 0.01)).delay_margin_within(1.0) == 0.0


@pytest.mark.oracle
def test_noise_reaches_the_inputs_as_in_a_run(two_link: Robot, two_link_law: HJISolution) -> None:
    plant, (x, u) = two_link.plant(), two_link.operating_point()
    filter = filter_of(plant, x)
    resting = EquilibriumLoop(two_link_law, filter, plant, PERIOD)
    estimator = ConstantGainFilter(filter, resting.gain(filter.process_noise))
    deviation = np.array([1e-6, 3e-6])
    run = Loop(plant, Controller(two_link_law, estimator, PERIOD)).run(noise=deviation, duration=60.0)
    measured = np.sqrt(np.mean((run.signals["input"][2000:] - u) ** 2, axis=0))
    expected = np.sqrt((margins(resting).noise_to_input ** 2) @ deviation**2)
    assert np.allclose(measured, expected, rtol=0.05)


def test_an_unstable_loop_has_no_margins() -> None:
    found = margins(mass(100.0, -1.0, 0.01))
    assert not found.stable
    assert found.delay_margin_s == 0.0
    assert math.isinf(found.peak_sensitivity)
    assert math.isinf(found.peak_noise_to_input)
    assert np.isnan(found.bandwidth).all()


def test_no_delay_harms_a_loop_that_stays_below_one() -> None:
    """ẋ = −5 x + u with u = −2 x: |L| < 1 at all frequencies. And no command acts on a fixed operating point."""
    plant = Plant(
        lambda x, u, d, p: np.array([-5.0 * x[0] + u[0]]),
        lambda x, u, p: x,
        states=("level",),
        inputs=("flow",),
    )
    law = linear_law(plant, [-2.0])
    found = margins(EquilibriumLoop(law, None, plant, 0.01, positions="level"))
    assert math.isinf(found.delay_margin_s)
    assert np.isnan(found.bandwidth).all()
    assert found.peak_sensitivity < 1.7


def test_a_delay_of_the_loop_is_part_of_it() -> None:
    """Twelve samples late, a loop stands that much less; its own figures are those of the delayed loop."""
    arm = fh.paper_arm()
    problem = arm.problem()
    law = fh.solve_hji(problem, gamma=2.0 * fh.smallest_gamma(problem), degree=2)
    plain, late = (EquilibriumLoop(law, None, arm.plant(), 1e-3, 0.0, delay=samples) for samples in (0, 12))
    found, delayed = margins(plain), margins(late)
    assert delayed.delay_margin_s == pytest.approx(found.delay_margin_s - 0.012, rel=1e-9)
    system = plain.linear().part("w", "u+w", 0.012)
    assert delayed.peak_sensitivity == pytest.approx(system.norm()[0], rel=1e-12)
    assert delayed.peak_sensitivity > 1.01 * found.peak_sensitivity
    assert delayed.noise_to_input == pytest.approx(plain.linear().part("v", "u", 0.012).rms(), rel=1e-12)


def closed_with(opened: DiscreteSystem, factors: np.ndarray) -> float:
    """Largest multiplier of an opened loop closed with its inputs times complex factors."""
    unit = np.eye(len(factors))
    around = np.diag(factors) @ np.linalg.inv(unit - opened.d @ np.diag(factors))
    return float(np.abs(np.linalg.eigvals(opened.a + opened.b @ around @ opened.c)).max())


@pytest.mark.oracle
def test_disk_margin_and_damping_of_a_mass_on_pd() -> None:
    """1/α = max |S − T|/2 [seiler2020], T's peak and ζ = d/(2 √k) in closed form."""
    k, d, period = 100.0, 8.0, 1e-5
    found = margins(mass(k, d, period))
    s = 1j * np.linspace(0.01, 100.0, 400_001)
    t = (d * s + k) / (s**2 + d * s + k)
    assert found.disk_margin == pytest.approx(1.0 / np.abs(0.5 - t).max(), rel=1e-4)
    assert found.peak_complementary == pytest.approx(np.abs(t).max(), rel=1e-4)
    assert found.damping == pytest.approx(d / (2.0 * math.sqrt(k)), rel=1e-3)
    assert found.damping_frequency == pytest.approx(math.sqrt(k), rel=1e-3)
    assert found.gain_margin == found.gain_margins[0, 1]
    low, high = found.disk_gain_margins
    assert low * high == pytest.approx(1.0)
    assert found.gain_margins[0, 0] <= low < 1.0 < high <= found.gain_margins[0, 1]
    assert 0.0 < found.disk_phase_margin <= found.delay_margin_s * found.delay_frequency * (1.0 + 1e-4)


@pytest.mark.oracle
def test_one_input_reaches_its_disk_margin(arm: Robot, cubic: HJISolution) -> None:
    """A factor of the disk's size at the worst frequency puts a multiplier on the unit circle; no smaller one does."""
    filter = filter_of(arm.plant(), np.zeros(4))
    loop = EquilibriumLoop(cubic, filter, arm.plant(inductance=True), PERIOD, 1.0, delay=4)
    found, linear = margins(loop), loop.linear()
    opened = dense_opened(linear)
    s = linear.part("w", "u+w").response(found.disk_frequency)[0, 0, 0]
    delta = 1.0 / (s - 0.5)  # 1 = δ (S − T)/2
    assert abs(delta) == pytest.approx(found.disk_margin, rel=1e-6)
    factor = lambda d: np.array([(1.0 - d / 2.0) / (1.0 + d / 2.0)])  # noqa: E731
    radii = [
        closed_with(opened, factor(size * sign * delta)) for size in (0.999, 1.001) for sign in (-1.0, 1.0)
    ]
    assert max(radii[:2]) < 1.0 < max(radii[2:])
    angles = np.exp(1j * np.linspace(0.0, 2.0 * np.pi, 60))
    assert all(closed_with(opened, factor(0.99 * found.disk_margin * a)) < 1.0 for a in angles)


@pytest.mark.oracle
def test_margins_of_several_inputs_one_at_a_time_and_at_once(
    two_link: Robot, two_link_law: HJISolution
) -> None:
    plant = two_link.plant()
    filter = filter_of(plant, two_link.operating_point()[0], "ekf", period=2e-3)
    loop = EquilibriumLoop(two_link_law, filter, plant, 2e-3, delay=2)
    found, linear = margins(loop), loop.linear()
    opened = dense_opened(linear)
    assert found.gain_margins.shape == (2, 2)
    for i, (low, high) in enumerate(found.gain_margins):
        for factor, stable in (
            (1.01 * low, True),
            (0.99 * low, False),
            (0.99 * high, True),
            (1.01 * high, False),
        ):
            if 1e-3 < factor < 1e3:
                factors = np.ones(2)
                factors[i] = factor
                assert (closed_with(opened, factors) < 1.0) == stable
    rng = np.random.default_rng(0)
    delta = 0.999 * found.disk_margin * np.exp(2j * np.pi * rng.uniform(size=(400, 2)))
    factors = (1.0 + delta / 2.0) / (1.0 - delta / 2.0)
    assert max(closed_with(opened, row) for row in factors) < 1.0
    # Not far below the largest: S − ½ needs at most its spectral radius' inverse.
    grid = np.geomspace(0.1, 1500.0, 2000)
    least = np.abs(np.linalg.eigvals(linear.part("w", "u+w").response(grid) - 0.5 * np.eye(2))).max()
    assert 0.5 / least < found.disk_margin <= 1.0 / least * (1.0 + 1e-6)


@pytest.mark.parametrize("delay", [0, 1, 5, 30, 90])
def test_damping_is_that_of_every_pole_of_the_loop_margins(
    arm: Robot, cubic: HJISolution, delay: int
) -> None:
    """Estimator and delay counted; as a free motion of that pole decays."""
    loop = EquilibriumLoop(cubic, filter_of(arm.plant(), np.zeros(4)), arm.plant(), PERIOD, 1.0, delay=delay)
    found, matrix = margins(loop), dense_system(loop.linear()).a
    values = np.linalg.eigvals(matrix).astype(complex)
    poles = np.log(values[np.abs(values) > math.exp(-0.5)]) / PERIOD
    assert found.damping == pytest.approx((-poles.real / np.abs(poles)).min(), abs=1e-9)
    assert found.stable == (np.abs(values).max() < 1.0)
    ratios, sizes = -poles.real / np.abs(poles), np.abs(poles)
    oscillate = (np.abs(poles.imag) > 2.0) | (ratios < 0.0)
    for limit in (10.0, 60.0, 350.0) if delay < 10 else ():  # else echoes of the queue
        slow, fast = ratios[oscillate & (sizes < limit)], ratios[sizes >= limit]
        expected = slow.min(initial=1.0), fast.min(initial=1.0)
        assert found.damping_about(limit) == pytest.approx(expected, abs=1e-9)


def test_a_slow_drift_is_no_oscillation_and_a_growing_one_is() -> None:
    """Poles −0.1 ± i of a mass on PD; with the sign of its damper changed they grow."""
    still, grows = (margins(mass(1.01, damping, 1e-3)).damping_about(350.0) for damping in (0.2, -0.2))
    assert still == (1.0, 1.0)
    assert grows[0] == pytest.approx(-0.1 / math.sqrt(1.01), rel=1e-2)


def test_a_delay_out_of_proportion_is_refused(arm: Robot, cubic: HJISolution) -> None:
    """Every input that waits is a state: 0.2 s are 200 samples of a loop, 500 s most likely a wrong unit."""
    assert EquilibriumLoop(cubic, None, arm.plant(), PERIOD, delay=200).delay == 200
    with refused_with(InvalidInput, "delay", "200 samples", "500000 samples") as caught:
        EquilibriumLoop(cubic, None, arm.plant(), PERIOD, delay=500_000)
    assert " 500 ms " in str(caught.value)


def test_the_bandwidth_counts_the_delay() -> None:
    """|T| of the delayed loop, not of the loop without its delay."""
    late = mass(100.0, 8.0, 1e-3, delay=40)
    found = margins(late)
    running = late.linear().part("r", "q", 0.04)
    followed = np.abs(running.response(np.array([1e-6, found.bandwidth[0]]))[:, 0, 0])
    assert followed[1] / followed[0] == pytest.approx(math.sqrt(0.5), rel=1e-6)
    assert abs(found.bandwidth[0] - margins(mass(100.0, 8.0, 1e-3)).bandwidth[0]) > 0.5
    # The linear loop knows its own delay: the same figures when it is given instead.
    assert margins(late.linear()).bandwidth == pytest.approx(found.bandwidth)
    assert margins(late.linear()).delay_margin_s == found.delay_margin_s
