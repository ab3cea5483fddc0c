"""Angles: the same problem turned by any angle gives the same estimates."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from tests.builders import FILTERS, filters, pairs
from tests.estimation.composing import composed
from tests.refusals import refused_with

import flexhinf as fh
from flexhinf.baselines import lqr
from flexhinf.errors import InvalidInput
from flexhinf.estimation import (
    ConstantGainFilter,
    ExtendedKalmanFilter,
    OutputInjectionObserver,
    UnscentedKalmanFilter,
    linear_model,
    stationary_gain,
)
from flexhinf.plant import linear_plant

# Kernels that run once each: 2 s instead of 3 s.
pytestmark = pytest.mark.usefixtures("unoptimised")


TURNS = [3.0, 0.0, 1.0, np.pi, -2.0, 3.3, 12.0]
PERIOD = 0.1


def wrapped(angle):
    """In (−π, π], as a compass gives it."""
    return np.arctan2(np.sin(angle), np.cos(angle))


def jumping(angle):
    """In [−π, π) by a function that has no rule of differences."""
    return angle - 2.0 * np.pi * np.floor((angle + np.pi) / (2.0 * np.pi))


def turning(wrap=wrapped, sampled=False, **options):
    """A heading and its rate, measured by two compasses that wrap, one of which leads with the rate."""

    def flow(x, u, d, p):
        rate = u[0] - p.drag * x[1] ** 3
        if sampled:
            return np.array([wrap(x[0] + PERIOD * x[1]), x[1] + PERIOD * rate])
        return np.array([x[1], rate])

    def output(x, u, p):
        return np.array([wrap(x[0]), wrap(x[0] + 0.3 * x[1] + 0.1 * x[1] ** 2)])

    given = {"outputs": ("compass", "leading"), "parameters": {"drag": 0.2}, "sampled": sampled}
    options = {"angles": ("compass", "leading", *(("heading",) if sampled else ())), **options}
    return fh.Plant(flow, output, ("heading", "rate"), ("torque",), **given, **options)


NOISE = np.array([[1e-2, 4e-3], [4e-3, 2e-2]])


def estimates(kind, plant, turn, make=None):
    """Means, less the turn, and covariances of a run past several turns; some elements are missing."""
    filter = kind(plant, PERIOD, 1e-3, NOISE, [turn + 0.2, 0.5], [0.5, 0.2])
    rng, x, found = np.random.default_rng(0), np.array([0.0, 1.0]), []
    step = None if make is None else make(filter)
    belief = filter.initial
    for k in range(60):
        clean = turn + np.array([x[0], x[0] + 0.3 * x[1] + 0.1 * x[1] ** 2])
        y = wrapped(clean + rng.multivariate_normal(np.zeros(2), NOISE))
        y[k % 2] = np.nan if k % 7 == 3 else y[k % 2]
        u = np.array([0.2 * np.sin(0.3 * k) + 0.2])
        if step is None:
            filter.correct(y)
            filter.predict(u)
            belief = filter._belief
        else:
            belief = step(belief, y, u)
        found.append((belief.mean - [turn, 0.0], belief.covariance))
        x = x + PERIOD * np.array([x[1], u[0] - 0.2 * x[1] ** 3])
    assert np.abs(wrapped(belief.mean[0] - turn - x[0])) < 0.3
    return found, x[0]


def assert_alike(first, second, atol=1e-9):
    for (mean, covariance), (other, expected) in zip(first, second, strict=True):
        away = mean - other
        away[0] = wrapped(away[0])
        np.testing.assert_allclose(away, 0.0, atol=atol)
        np.testing.assert_allclose(covariance, expected, rtol=1e-7, atol=1e-10)


@pytest.mark.quick_cases(1)
@pytest.mark.oracle
@pytest.mark.parametrize(
    ("kind", "turn", "wrap", "sampled"), pairs(list(FILTERS), TURNS, [wrapped, jumping], [False, True])
)
def test_turned_by_any_angle_it_gives_the_same_estimates(kind, turn, wrap, sampled):
    """Those of a plant that never wraps and is told whole turns, too."""
    found, far = estimates(FILTERS[kind], turning(wrap, sampled), turn)
    assert far > 5.0
    assert_alike(found, estimates(FILTERS[kind], turning(lambda angle: angle, sampled), 0.0)[0])


@pytest.mark.ci("compiles six filters")
@pytest.mark.oracle
@pytest.mark.parametrize("kind", [FILTERS[name] for name in ("ukf", "ukf, rows", "ekf")])
@pytest.mark.parametrize("sampled", [False, True])
def test_in_compiled_code_too(kind, sampled):
    plant = turning(jumping, sampled)
    assert_alike(estimates(kind, plant, 3.0, composed)[0], estimates(kind, plant, 3.0)[0])


@pytest.mark.ci("runs every filter twice")
@filters()
def test_what_is_not_declared_is_no_angle(kind):
    """The estimate is lost where the compass jumps."""
    with pytest.raises(AssertionError):
        assert_alike(estimates(kind, turning(angles=()), 0.0)[0], estimates(kind, turning(), 0.0)[0])


@pytest.mark.oracle
@pytest.mark.parametrize("form", ["covariance", "square_root"])
def test_points_on_both_sides_of_the_cut_average_to_the_cut(form):
    """At 180° ± 1 rad: mean and covariance of the outputs are those at 0° ± 1 rad, a half turn on."""
    found = []
    for turn in (0.0, np.pi):
        filter = UnscentedKalmanFilter(
            turning(jumping), PERIOD, 1e-3, NOISE, [turn, 0.0], [1.0, 1e-6], form=form
        )
        filter.correct(jumping(np.array([turn + 0.4, turn + 0.4])))
        found.append((filter.mean - [turn, 0.0], filter.covariance, filter.log_likelihood))
    for first, second in zip(*found, strict=True):
        np.testing.assert_allclose(first, second, atol=1e-12)
    assert found[0][0][0] > 0.3


# Other estimators, controllers, loops and C ---------------------------------------------------------------
def pendulum(wrap, **options):
    return fh.Plant(
        lambda x, u, d, p: np.array([x[1], u[0] - p.drag * x[1] + 0.0 * np.sin(x[0])]),
        lambda x, u, p: np.array([wrap(x[0])]),
        ("angle", "speed"), ("torque",), outputs=("angle",), parameters={"drag": 0.2}, angles=("angle",), **options,
    )  # fmt: skip


def constant(plant, period, r, q, mean, p0):
    ekf = ExtendedKalmanFilter(plant, period, r, q, mean, p0)
    return ConstantGainFilter(
        ekf,
        stationary_gain(
            linear_model(ekf, np.array(mean), np.zeros(1)), ekf.process_noise, ekf.measurement_noise
        ),
    )


def controller(kind, turn, wrap=wrapped, **options):
    """Integral action on an angle, about a turn."""
    plain = pendulum(lambda angle: angle)
    penalty = fh.Penalty({"angle": 3.0, "speed": 1.0, "angle_integral": 2.0}, 1.0)
    law = lqr(plain.with_objective(penalty, "disturbance", ("angle",), pose=[turn]))
    return fh.Controller(law, kind(pendulum(wrap), 0.02, 1e-6, 1e-5, [turn, 0.0], 1e-3), 0.02, **options)


@pytest.mark.quick_cases(1)
@pytest.mark.oracle
@filters(**{"constant gain": constant})
@pytest.mark.parametrize("options", [{}, {"offset_time": 0.1}], ids=["plain", "offset"])
def test_a_loop_through_the_cut_is_that_of_another_turn(kind, options):
    """The encoder jumps: estimate, integral and input go on, counting turns."""
    runs = []
    for turn, wrap in ((0.0, lambda angle: angle), (3.0, wrapped), (3.0, jumping)):
        loop = fh.Loop(pendulum(wrap), controller(kind, turn, wrap, **options))
        runs.append(loop.run(turn + 0.8, noise=1e-3, duration=6.0, initial_state=[turn + 0.05, 0.0], seed=1))
    assert np.ptp(runs[1].signals["output"]) > 6.0
    for run, turn in zip(runs[1:], (3.0, 3.0), strict=True):
        np.testing.assert_allclose(run.signals["input"], runs[0].signals["input"], atol=1e-8)
        estimate = run.signals["estimate"] - [turn, 0.0]
        np.testing.assert_allclose(estimate, runs[0].signals["estimate"], atol=1e-9)
    stepped = controller(kind, 3.0, jumping, **options)
    for y, u in zip(runs[2].signals["output"], runs[2].signals["input"], strict=True):
        np.testing.assert_array_equal(stepped.step(y, 3.8), u)


@pytest.mark.oracle
def test_output_injection_takes_the_turn_that_is_near():
    """An observer needs an output that is linear in the state; the measurement may wrap all the same."""
    plant = pendulum(lambda angle: angle)
    first, second = (OutputInjectionObserver(plant, 0.02, 1e-6, 1e-5, [turn, 0.0]) for turn in (0.0, 3.1))
    for k in range(200):
        y = 0.01 * k + 0.1
        first.correct([y])
        second.correct([wrapped(y + 3.1)])
        np.testing.assert_allclose(second.mean - [3.1, 0.0], first.mean, atol=1e-10)
        assert second.log_likelihood == pytest.approx(first.log_likelihood, abs=1e-8)
        for filter in (first, second):
            filter.predict([0.1])


# The declaration ------------------------------------------------------------------------------------------
def test_files_pickles_and_copies_keep_the_angles(tmp_path):
    stored = controller(FILTERS["ukf, rows"], 3.0)
    stored.save(tmp_path / "one")
    loaded = fh.load_controller(tmp_path / "one")
    copied = pickle.loads(pickle.dumps(stored))
    assert loaded.estimator.plant.angles == copied.estimator.plant.angles == ("angle",)
    for k in range(40):
        y = wrapped(3.0 + 0.01 * k)
        u = stored.step(y, 3.5)
        np.testing.assert_array_equal(loaded.step(y, 3.5), u)
        np.testing.assert_array_equal(copied.step(y, 3.5), u)
    plant = turning()
    assert plant.with_parameters(drag=0.5).angles == plant.angles == ("compass", "leading")
    assert linear_plant(plant, np.zeros(2), np.zeros(1)).angles == plant.angles
    assert plant.code_key != turning(angles=()).code_key
    assert turning(angles=()).code_key == turning(angles=()).code_key


def test_a_group_stands_for_its_signals():
    plant = turning(angles=("both",), groups={"both": ("compass", "leading")})
    assert plant.angles == ("compass", "leading")


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ({"angles": ("heading", "torque")}, ("torque",)),
        ({"angles": "north"}, ("north",)),
        ({"angles": ("compass", "compass")}, ("compass",)),
        ({"angles": (1,)}, ()),
        ({"angles": ("compass",), "units": {"compass": "deg"}}, ("compass", "rad", "deg")),
    ],
)
def test_what_is_no_angle_is_refused(options, named):
    with refused_with(InvalidInput, *named):
        turning(**options)
