"""The loop as a function of its filter's gain, against a new linearisation with that gain."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import flexhinf as fh
from flexhinf.analysis import EquilibriumLoop, FilteredLoop, frequency_response, margins
from flexhinf.analysis.corners import MOTOR_VELOCITIES, VELOCITIES, ProcessNoise


@pytest.fixture(scope="module", params=[0, 2])
def loop(request: pytest.FixtureRequest) -> EquilibriumLoop:
    robot = fh.paper_arm()
    plant = robot.plant()
    law = fh.linear_law(robot.problem(), gamma=200.0)
    x, u = robot.operating_point(None)
    filter = fh.ExtendedKalmanFilter(plant, 1e-3, 1e-7 * np.eye(4), 1e-8 * np.eye(1), x, 1e-6 * np.eye(4))
    return EquilibriumLoop(
        law,
        filter,
        robot.plant(extras=("inductance",)),
        1e-3,
        equilibrium=(x, u),
        delay=1,
        latency=request.param,
    )


@pytest.mark.quick_cases(2)
@pytest.mark.oracle
@pytest.mark.parametrize("noise", [ProcessNoise(VELOCITIES, 1e-6), ProcessNoise(MOTOR_VELOCITIES, 1e-4)])
def test_a_gain_gives_the_linear_loop_and_its_figures(loop: EquilibriumLoop, noise: ProcessNoise) -> None:
    process = noise.covariance(loop.step.states)
    filtered = FilteredLoop(loop, 5.0)
    expected, found = loop.linear(process_noise=process), filtered.linear(loop.gain(process))
    for name in ("memory", "law"):
        one, other = getattr(found, name), getattr(expected, name)
        assert np.abs(one - other).max() < 1e-11 * np.abs(other).max()
    figures, exact = filtered.margins(process), margins(expected)
    assert figures.damping == pytest.approx(exact.damping, rel=1e-6)
    assert figures.gain_margin == pytest.approx(exact.gain_margin, rel=1e-4)
    assert figures.peak_sensitivity == pytest.approx(exact.peak_sensitivity, rel=1e-4)
    noises = figures.input_noise(np.array([1e-4]))
    assert noises == pytest.approx(1e-4 * np.linalg.norm(exact.noise_to_input, axis=1), rel=1e-6)
    assert figures.compliance(50.0) == pytest.approx(exact.compliance(50.0), rel=1e-4)
    answers = frequency_response(expected, np.linspace(0.1, 50.0, 4000)).disturbance
    links = [k for k, name in enumerate(expected.disturbances) if name.startswith("link_torque")]
    largest = np.linalg.norm(answers[:, :, links], 2, axis=(1, 2)).max()
    assert exact.compliance(50.0) == pytest.approx(largest, rel=1e-3)


@pytest.mark.parametrize("loop", [2], indirect=True)
def test_an_unstable_loop_has_no_figures(loop: EquilibriumLoop) -> None:
    filtered = FilteredLoop(loop, 5.0)
    filtered.own = replace(filtered.own, delay=0.3)
    found = filtered.margins(1e-7 * np.eye(4))
    assert not found.stable
    assert found.peak_sensitivity == found.compliance(50.0) == np.inf
    assert np.isinf(found.input_noise(np.array([1e-4]))).all()
