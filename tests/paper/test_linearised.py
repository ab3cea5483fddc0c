"""The linearised loop against SciPy's exponential, and against runs of the nonlinear loop."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.linalg import expm

from flexhinf.loop import Step
from flexhinf.paper.bench import PaperBench
from flexhinf.paper.growth import growth_rate
from flexhinf.paper.linearised import RestingLoop
from flexhinf.paper.settings import PaperSettings
from flexhinf.scalars import jacobian

PERIOD = 1e-3


@pytest.fixture(scope="module")
def bench() -> PaperBench:
    return PaperBench(PaperSettings(period=PERIOD))


def resting(bench: PaperBench, goal: float, coil: bool = True, kind: str = "ekf") -> RestingLoop:
    plant = bench.arm.plant(inductance=coil)
    return RestingLoop(bench.nonlinear, bench.estimator(kind), plant, bench.settings.period, goal)


def held(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Exact discretisation with the input held."""
    n = len(a)
    both = expm(PERIOD * np.vstack([np.hstack([a, b]), np.zeros((b.shape[1], n + b.shape[1]))]))
    return both[:n, :n], both[:n, n:]


@pytest.mark.oracle
@pytest.mark.parametrize("coil", [False, True])
@pytest.mark.parametrize("goal", [math.pi / 2, math.pi])
def test_modes_are_those_of_the_loop_assembled_by_hand(bench: PaperBench, goal: float, coil: bool) -> None:
    """correct → integral of the measured error → law → time update, written out for the linear parts."""
    loop = resting(bench, goal, coil)
    found = loop.modes([bench.arm.nominal])
    n = loop.plant.n
    a, b, _, _ = loop.plant.linearise(*loop.plant_rest)
    phi, gamma = held(a, b)
    f, g = held(*loop.filter.plant.linearise(*loop.model_rest)[:2])  # type: ignore[union-attr]
    h = np.array([[1.0, 0.0, 0.0, 0.0]])
    gain = loop.gain(loop.filter.process_noise)  # type: ignore[union-attr]
    rest = found.rest[0]
    integral = rest[n + loop._places["moving"].tolist().index(int(loop._places["integral"][0]))]
    law, data = bench.nonlinear, np.ravel(bench.nonlinear.law_data)
    slope = jacobian(law.evaluate_law, 5, data.size)
    k = slope(np.concatenate([loop.model_rest[0], [integral]]), data)[1]
    # State of the sampled loop: true x, predicted estimate, integral before, measured position before.
    measured = np.eye(1, n + 6)
    estimate = np.hstack([gain @ np.eye(1, n), np.eye(4) - gain @ h, np.zeros((4, 2))])
    error = np.zeros((1, n + 6))
    error[0, n + 4], error[0, n + 5] = 1.0, 0.5 * PERIOD
    error += 0.5 * PERIOD * measured
    u = k[:, :4] @ estimate + k[:, 4:] @ error
    true = np.hstack([phi, np.zeros((n, 6))]) + gamma @ u
    assembled = np.vstack([true, f @ estimate + g @ u, error, measured])
    expected = np.sort(np.abs(np.linalg.eigvals(assembled)))[::-1]
    assert np.allclose(np.sort(np.abs(found.multipliers[0]))[::-1][:8], expected[:8], atol=1e-10)


@pytest.mark.oracle
@pytest.mark.parametrize("kind", ["ukf", "none"])
def test_rate_is_that_of_a_long_run(bench: PaperBench, kind: str) -> None:
    signs = {
        "mass": -1,
        "stiffness": 1,
        "length": -1,
        "link_inertia": -1,
        "motor_inertia": -1,
        "friction": -1,
    }
    values = bench.arm.corner({**signs, "resistance": -1, "torque_constant": 1, "back_emf_constant": -1})
    expected = resting(bench, math.pi, kind=kind).modes([values]).rate[0]
    estimator = bench.estimator(kind)
    run = bench.run(
        bench.nonlinear,
        Step(math.pi),
        30.0,
        true_values=values,
        inductance=True,
        estimator=estimator,
        noise=False,
    )
    measured, size = growth_rate(run)
    assert size > 1e-9
    assert measured == pytest.approx(expected, abs=5e-3)
    assert (expected > 0.0) == (kind == "ukf")  # the corner that only the estimated loop does not withstand


def test_no_rest_is_infinite(bench: PaperBench) -> None:
    """An estimator that ignores the measurement drifts off a plant that differs from its model."""
    loop = RestingLoop(bench.nonlinear, bench.estimator("ekf", 0.0), bench.arm.plant(), PERIOD, math.pi / 2)
    modes = loop.modes([bench.arm.corner({"mass": 1.0})])
    assert math.isinf(modes.rate[0])
    assert not modes.stable[0]
    assert np.isnan(modes.rest).all()


def test_plants_do_not_mix(bench: PaperBench) -> None:
    loop, rng = resting(bench, math.pi), np.random.default_rng(3)
    values = [bench.arm.draw(rng) for _ in range(5)]
    together = loop.modes(values).rate
    assert np.allclose(together, [loop.modes([v]).rate[0] for v in values], rtol=1e-9)
    assert len(set(np.round(together, 6))) == 5
