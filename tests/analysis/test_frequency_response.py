"""Frequency responses against python-control's interconnection and against sines through the nonlinear loop."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from tests.analysis.conftest import dense_system, filter_of
from tests.builders import linear_law

from flexhinf.analysis import EquilibriumLoop, LinearLoop, frequency_response, margins
from flexhinf.analysis.worst_disturbance import ZeroOrderHold
from flexhinf.errors import InvalidInput
from flexhinf.estimation import ConstantGainFilter
from flexhinf.hinf import HJISolution
from flexhinf.loop import Controller, Loop, Sine
from flexhinf.robot import Robot

PERIOD = 1e-3
GRID = np.array([0.5, 3.0, 20.0, 150.0, 900.0])

# Eight loops that run once: 0.7 s instead of 1.2 s.
pytestmark = pytest.mark.usefixtures("unoptimised")


def interconnected(linear: LinearLoop) -> tuple[Any, Any, Any]:
    """(L, S, d → q) by python-control: its own sampling of the plant, its series and feedback, u late by z⁻ʲ."""
    control = pytest.importorskip("control")
    m, k, s = linear.b.shape[1], linear.g.shape[1], len(linear.memory)
    both = control.ss(
        linear.a, np.hstack([linear.b, linear.g]), np.vstack([linear.c, linear.positions]),
        np.zeros((len(linear.c) + len(linear.positions), m + k)),
    )  # fmt: skip
    plant = control.sample_system(both, linear.period, "zoh")
    law = control.ss(
        linear.memory[:, :s], linear.memory[:, s:], linear.law[:, :s], linear.law[:, s:], linear.period
    )
    p = len(linear.c)
    by_u, by_d = (control.ss(plant.A, plant.B[:, c], plant.C, 0.0 * plant.D[:, c], linear.period)
                  for c in (slice(0, m), slice(m, m + k)))  # fmt: skip
    samples = round(linear.delay / linear.period)
    queue = control.ss(
        np.kron(np.eye(samples, k=-1), np.eye(m)), np.vstack([np.eye(m), np.zeros(((samples - 1) * m, m))]),
        np.hstack([np.zeros((m, (samples - 1) * m)), np.eye(m)]), np.zeros((m, m)), linear.period,
    ) if samples else control.ss([], [], [], np.eye(m), linear.period)  # fmt: skip
    z = np.exp(1j * GRID * linear.period)

    def values(system: Any) -> np.ndarray:
        return np.moveaxis(np.asarray(system(z, squeeze=False)), -1, 0)

    through = values(queue)
    loop = -values(law) @ values(by_u)[:, :p] @ through
    sensitivity = np.linalg.inv(np.eye(m) + loop)
    back = values(by_u)[:, p:] @ through @ sensitivity @ values(law) @ values(by_d)[:, :p]
    return loop, sensitivity, values(by_d)[:, p:] + back


@pytest.mark.oracle
@pytest.mark.parametrize("kind", [None, "ukf"])
@pytest.mark.parametrize("delay", [0, 3])
def test_one_link_as_python_control_connects_it(
    arm: Robot, cubic: HJISolution, kind: str | None, delay: int
) -> None:
    filter = None if kind is None else filter_of(arm.plant(), np.zeros(4), kind)
    loop = EquilibriumLoop(cubic, filter, arm.plant(inductance=True), PERIOD, math.pi / 2, delay=delay)
    _compare(loop)


@pytest.mark.oracle
def test_two_links_as_python_control_connects_them(two_link: Robot, two_link_law: HJISolution) -> None:
    plant, (x, u) = two_link.plant(), two_link.operating_point()
    gains = np.hstack([np.diag([400.0, 90.0]), np.diag([40.0, 9.0]), np.zeros((2, 4))])
    pd = linear_law(plant, -gains, x, u)
    for law, options in (
        (two_link_law, {}),
        (pd, {"equilibrium": (x, u), "moving": True, "positions": plant.states[:2]}),
    ):
        _compare(EquilibriumLoop(law, filter_of(plant, x, "ekf"), plant, PERIOD, delay=2, **options))


def _compare(loop: EquilibriumLoop) -> None:
    linear = loop.linear()
    found, (opened, sensitivity, compliance) = frequency_response(loop, GRID), interconnected(linear)
    assert np.allclose(found.loop_transfer, opened, rtol=1e-6, atol=1e-9 * np.abs(opened).max())
    assert np.allclose(found.sensitivity, sensitivity, rtol=1e-6, atol=1e-9)
    assert np.allclose(found.complementary, opened @ sensitivity, rtol=1e-6, atol=1e-7)
    assert np.allclose(found.disturbance, compliance, rtol=1e-5, atol=1e-9 * np.abs(compliance).max())
    # One input's loop, the others closed: S_ii = 1/(1 + L_i).
    assert np.allclose(np.diagonal(sensitivity, axis1=1, axis2=2), 1.0 / (1.0 + found.input_loops), rtol=1e-6)
    assert np.allclose(np.exp(found.linear.closed_loop.poles * loop.period), _multipliers(linear), atol=1e-6)


def _multipliers(linear: LinearLoop) -> np.ndarray:
    """All but those at zero; of a delayed loop all that last two samples."""
    values = dense_system(linear).multipliers
    kept = values[np.abs(values) > (math.exp(-0.5) if linear.delay else 1e-12)]
    return kept[np.argsort(-np.log(kept).real, kind="stable")]


def phasor(times: np.ndarray, values: np.ndarray, frequency: float) -> complex:
    """Of sin(ωt), by least squares with an offset."""
    table = np.column_stack([np.sin(frequency * times), np.cos(frequency * times), np.ones(len(times))])
    real, imaginary, _ = np.linalg.lstsq(table, values, rcond=None)[0]
    return complex(real, imaginary)


@pytest.mark.oracle
@pytest.mark.parametrize(
    ("kind", "delay"), [pytest.param(None, 0, marks=pytest.mark.ci("one more loop")), ("ekf", 8)]
)
def test_sines_through_the_nonlinear_loop(
    two_link: Robot, two_link_law: HJISolution, kind: str | None, delay: int
) -> None:
    """A small sine as command of the shoulder, and one as torque at the elbow's link: gain and phase at both joints."""
    plant, (x, _) = two_link.plant(), two_link.operating_point()
    filter = None if kind is None else filter_of(plant, x, kind)
    resting = EquilibriumLoop(two_link_law, filter, plant, PERIOD, delay=delay)
    estimator = None if filter is None else ConstantGainFilter(filter, resting.gain(filter.process_noise))
    loop = Loop(plant, Controller(two_link_law, estimator, PERIOD), delay=delay * PERIOD)
    for frequency in (2.0, 15.0):
        found = frequency_response(resting, frequency)
        turns = max(3.0, round(6.0 * frequency / (2.0 * np.pi)))
        length = 10.0 + turns * 2.0 * np.pi / frequency
        grid = PERIOD * np.arange(round(length / PERIOD) + 1)
        wave = np.sin(frequency * grid)
        command = {found.linear.names[0]: Sine(1e-6, frequency / (2.0 * np.pi), offset=float(x[0]))}
        torque = found.linear.disturbances.index("link_torque_elbow")
        for arguments, column, size in (
            ({"reference": command}, found.command[:, :, 0][0], 1e-6),
            (
                {"disturbance": {"link_torque_elbow": ZeroOrderHold(grid, 1e-4 * wave)}},
                found.disturbance[0, :, torque],
                1e-4,
            ),
        ):
            run = loop.run(duration=length, **arguments)
            late = run.time > 10.0
            for joint in (0, 1):
                measured = phasor(run.time[late], run.signals["state"][late, joint], frequency) / size
                assert measured == pytest.approx(column[joint], abs=4e-3 * np.abs(column).max())


def test_the_peaks_are_those_of_the_margins(arm: Robot, cubic: HJISolution) -> None:
    loop = EquilibriumLoop(
        cubic, filter_of(arm.plant(), np.zeros(4)), arm.plant(inductance=True), PERIOD, 1.0, delay=5
    )
    found, exact = frequency_response(loop), margins(loop)
    assert found.linear.closed_loop.stable
    peaks = [np.linalg.norm(each, 2, axis=(1, 2)).max() for each in (found.sensitivity, found.complementary)]
    assert 0.99 * exact.peak_sensitivity < peaks[0] <= exact.peak_sensitivity * (1.0 + 1e-9)
    assert 0.99 * exact.peak_complementary < peaks[1] <= exact.peak_complementary * (1.0 + 1e-9)
    # The bandwidth is read off the same curve, delay included.
    followed = np.abs(frequency_response(loop, [1e-4, exact.bandwidth[0]]).command[:, 0, 0])
    assert followed[1] / followed[0] == pytest.approx(math.sqrt(0.5), rel=1e-6)
    # From a decade below the slowest pole to the highest frequency that samples have.
    multipliers = dense_system(found.linear).multipliers
    slowest = np.abs(np.log(multipliers[np.abs(multipliers) > 1e-6])).min() / PERIOD
    assert found.frequencies[[0, -1]] == pytest.approx([0.1 * slowest, math.pi / PERIOD], rel=1e-6)
    assert len(repr(found)) < 200


def test_frequencies_that_do_not_fit(arm: Robot, cubic: HJISolution) -> None:
    loop = EquilibriumLoop(cubic, None, arm.plant(), PERIOD)
    for wrong in ([0.0], [-1.0], [4000.0], [math.nan], []):
        with pytest.raises(InvalidInput, match="frequencies"):
            frequency_response(loop, wrong)
