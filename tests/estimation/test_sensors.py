"""Sensors of their own noise, quantisation, period and delay, in estimators."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from tests.builders import FORMS, KALMAN, linear_plant, pairs
from tests.estimation import kalman
from tests.estimation.composing import composed
from tests.estimation.kalman import LinearCase
from tests.refusals import refused_with

import flexhinf as fh
from flexhinf.errors import InvalidInput
from flexhinf.estimation import ExtendedKalmanFilter, UnscentedKalmanFilter
from flexhinf.plant import SensorTable

# Kernels that run once each: half of the time.
pytestmark = pytest.mark.usefixtures("unoptimised")


PERIOD = 0.02


def linear(case, **options):
    return linear_plant(
        case.a, case.b, case.c, states=("i", "j", "k"), inputs=("u", "v"), outputs=("first", "second"),
        groups={"both": ("first", "second")}, **options,
    )  # fmt: skip


def sensors(delays=(0, 0), noise=(0.3, 0.2)):
    return tuple(
        fh.Sensor(name, noise=sigma, delay=k * PERIOD)
        for name, k, sigma in zip(("first", "second"), delays, noise)
    )


# Noise and quantisation ---------------------------------------------------------------------------------
@KALMAN
@FORMS
def test_noise_and_quantisation_are_the_measurement_noise(kind, form):
    case = LinearCase(3, 2, 2)
    several = (fh.Sensor("second", noise=0.3), fh.Sensor("first", noise=0.2, quantisation=0.6))
    one = kind(**case.arguments(plant=linear(case), measurement_noise=None, sensors=several, form=form))
    other = kind(
        **case.arguments(plant=linear(case), measurement_noise=[0.04 + 0.36 / 12.0, 0.09], form=form)
    )
    np.testing.assert_allclose(np.diag(one.measurement_noise), [0.07, 0.09], rtol=1e-14)
    for estimator in (one, other):
        estimator.correct([0.3, -0.2])
        estimator.predict([0.1, 0.2])
    np.testing.assert_allclose(one.mean, other.mean, rtol=1e-12)


def test_a_group_has_one_sensor():
    robot = fh.load_robot("planar-two-link")
    plant = robot.plant(("motor_position",))
    table = SensorTable.of(fh.Sensor("motor_position", noise=1e-4), plant.outputs, plant.expanded, 1e-3)
    np.testing.assert_allclose(table.variances, [1e-8, 1e-8])
    assert table.periods.tolist() == [1, 1]


# Delay ------------------------------------------------------------------------------------------------------
def conditioned(case, f, g, delays, inputs, seen, noise):
    """Mean and covariance of x_K given y_0 … y_K, all at once: y_k shows outputs of x_{max(0, k − delay)}."""
    count, n = len(seen), 3
    mean, root = [case.mean], [np.eye(n)]
    for u in inputs:
        mean.append(f @ mean[-1] + g @ u)
        root.append(f @ root[-1])
    prior = np.zeros((n * count, n * count))
    covariance = case.p0
    spread = [case.p0]
    for _ in inputs:
        covariance = f @ covariance @ f.T + case.q
        spread.append(covariance)
    for i in range(count):
        block = spread[i]
        for j in range(i, count):
            prior[n * j : n * j + n, n * i : n * i + n] = block
            prior[n * i : n * i + n, n * j : n * j + n] = block.T
            block = f @ block
    rows, expected = np.zeros((2 * count, n * count)), np.zeros(2 * count)
    for k in range(count):
        for i, delay in enumerate(delays):
            at = max(0, k - delay)
            rows[2 * k + i, n * at : n * at + n] = case.c[i]
            expected[2 * k + i] = case.c[i] @ mean[at]
    there = np.isfinite(np.ravel(seen))
    rows, left = rows[there], (np.ravel(seen) - expected)[there]
    inner = rows @ prior @ rows.T + np.diag(np.tile(np.square(noise), count)[there])
    gain = np.linalg.solve(inner, rows @ prior).T
    whole = gain @ left
    last = slice(n * (count - 1), n * count)
    return mean[-1] + whole[last], (prior - gain @ rows @ prior)[last, last]


@pytest.mark.quick_cases(2)
@pytest.mark.oracle
@pytest.mark.parametrize(
    ("kind", "form", "sampled", "delays", "every"),
    pairs(
        [UnscentedKalmanFilter, ExtendedKalmanFilter],
        ["covariance", "square_root"],
        [False, True],
        [(0, 2), (3, 1), (1, 1)],
        [1, 2],
    ),
)
def test_what_is_late_is_taken_for_what_it_was(kind, form, sampled, delays, every):
    """Against the joint density of all states of all samples, conditioned at once; the first sensor gives a value at
    `every` other sample."""
    case = LinearCase(3, 2, 2, seed=4)
    plant = linear(case, sampled=sampled)
    one = kind(**case.arguments(plant=plant, measurement_noise=None, sensors=sensors(delays), form=form))
    plain = kind(**case.arguments(plant=plant, form=form))
    assert one.plant.sampled
    assert one.plant.n == 3 + sum(delays)
    f, g = (case.a, case.b) if sampled else case.map(plain.stages, plain.sub_steps)
    seen, inputs = case.rng.normal(size=(6, 2)), case.rng.normal(size=(5, 2))
    seen[np.arange(6) % every != 0, 0] = np.nan
    step, belief = composed(one), one.initial
    for k, y in enumerate(seen):
        one.correct(y)
        if k < 5:
            belief = step(belief, y, inputs[k])
            one.predict(inputs[k])
            assert kalman.relative(belief.mean, belief.covariance, one.mean, one.covariance) < 1e-10
    mean, covariance = conditioned(case, f, g, delays, inputs, seen, (0.3, 0.2))
    assert kalman.relative(one.mean[:3], one.covariance[:3, :3], mean, covariance) < 1e-9


@pytest.mark.quick_cases(1)
@KALMAN
@FORMS
def test_a_late_angle_may_jump_by_a_turn(kind, form):
    """Against the same arm with an angle that counts turns."""

    def seen(x, u, p):
        return np.array([np.arctan2(np.sin(x[0]), np.cos(x[0]))])

    found = {}
    for name, output, angles in (("jumps", seen, ("seen",)), ("counts", lambda x, u, p: x[:1], ())):
        plant = fh.Plant(
            lambda x, u, d, p: np.array([x[1], u[0]]), output, ("angle", "speed"), ("push",), outputs=("seen",),
            angles=angles,
        )  # fmt: skip
        late = fh.Sensor("seen", noise=0.01, delay=2 * PERIOD)
        estimator = kind(plant, PERIOD, [1e-8, 1e-6], None, [3.0, 1.0], [0.01, 0.01], sensors=late, form=form)
        assert ("seen_past_2" in estimator.plant.angles) == bool(angles)
        found[name] = []
        for k in range(40):
            angle = 3.02 + 1.05 * PERIOD * max(0, k - 2)
            estimator.correct([np.arctan2(np.sin(angle), np.cos(angle)) if angles else angle])
            found[name].append(estimator.mean[:2])
            estimator.predict([0.0])
    np.testing.assert_allclose(found["jumps"], found["counts"], atol=1e-6)
    assert found["jumps"][-1][0] > np.pi


@pytest.mark.ci("compiles a controller as C")
def test_a_controller_of_a_late_sensor_is_saved_and_compiled(tmp_path):
    """The law's states are among those of the map; start at a pose and the bound of windup are those of the plant."""
    plant = fh.load_robot("paper").plant(("link_position", "motor_position"))
    problem = plant.with_objective(
        {"link_position": 10.0, "link_position_integral": 30.0}, "disturbance", ("link_position",)
    )
    law = fh.linear_law(problem, gamma=40.0)
    several = (fh.Sensor("link_position", delay=2e-3, noise=1e-4), fh.Sensor("motor_position", noise=1e-4))
    given = (plant, 1e-3, 1e-9, None, np.zeros(4), 1e-6)
    control = fh.Controller(law, ExtendedKalmanFilter(*given, sensors=several), 1e-3)
    plain = fh.Controller(law, ExtendedKalmanFilter(plant, 1e-3, 1e-9, 1e-8, np.zeros(4), 1e-6), 1e-3)
    assert control.estimated[4:] == ("link_position_past_1", "link_position_past_2")
    np.testing.assert_allclose(control.windup.limit, plain.windup.limit, rtol=1e-6)
    control.save(tmp_path / "controller")
    others = [fh.load_controller(tmp_path / "controller"), pickle.loads(pickle.dumps(control))]
    compiled = fh.load_compiled(fh.compile_controller(control, tmp_path / "library.so"))
    for k in range(8):
        y = [1e-3 * k, 1.2e-3 * k]
        u = control.step(y)
        np.testing.assert_array_equal([other.step(y) for other in others], [u, u])
        np.testing.assert_allclose(compiled.step(y), u, rtol=1e-9)
    for one in (control, plain):
        one.reset(pose=[0.3])
    stood = (
        control.step([0.3, 0.3 + 9.8 * np.sin(0.3) / 100.0]),
        plain.step([0.3, 0.3 + 9.8 * np.sin(0.3) / 100.0]),
    )
    np.testing.assert_allclose(*stood, rtol=1e-6)


OTHERS = pytest.mark.ci("compiles the other pairs of filter and form")


# A filter without a loop ------------------------------------------------------------------------------------
@pytest.mark.quick_cases(1)
@pytest.mark.parametrize(
    ("kind", "form"),
    [
        (UnscentedKalmanFilter, "covariance"),
        (ExtendedKalmanFilter, "square_root"),
        pytest.param(UnscentedKalmanFilter, "square_root", marks=OTHERS),
        pytest.param(ExtendedKalmanFilter, "covariance", marks=OTHERS),
    ],
)
def test_a_value_that_is_held_counts_once(kind, form):
    """By NumPy in the first calls, then by machine code; and in a log, where a row is a sample."""
    plant = fh.Plant(
        lambda x, u, d, p: np.array([x[1], u[0] - x[0]]),
        lambda x, u, p: x,
        ("a", "b"),
        ("force",),
        outputs=("a", "b"),
    )
    own = (fh.Sensor("a", noise=0.1, period=4 * PERIOD), fh.Sensor("b", noise=0.2))
    slow = kind(plant, PERIOD, 1e-4, None, [0.0, 0.0], 1.0, form=form, sensors=own)
    plain = kind(plant, PERIOD, 1e-4, [0.01, 0.04], [0.0, 0.0], 1.0, form=form)
    rows, means = np.random.default_rng(0).normal(size=(140, 2)), []
    for k, y in enumerate(rows):
        slow.correct(y)
        plain.correct(y if k % 4 == 0 else [np.nan, y[1]])
        means.append(slow.mean)
        np.testing.assert_allclose(slow.mean, plain.mean, rtol=1e-12)
        for one in (slow, plain):
            one.predict([1.0])
    assert slow.repairs == plain.repairs
    slow.reset()
    slow.correct([1.0, np.nan])
    assert slow.mean[0] > 0.5
    log = PERIOD * np.arange(len(rows)), np.ones(len(rows)), rows
    np.testing.assert_allclose(fh.filter_log(slow, log)["estimate"].values, means, rtol=1e-6, atol=1e-9)


# What does not fit -----------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("given", "anchors"),
    [
        ({"period": 0.0}, ("period", 0.0)),
        ({"noise": -1e-3}, ("noise", -1e-3)),
        ({"delay": np.inf}, ("delay",)),
        ({"quantisation": "fine"}, ("quantisation", "fine")),
    ],
)
def test_a_sensor_has_numbers(given, anchors):
    with refused_with(InvalidInput, "first", *anchors):
        fh.Sensor("first", **given)


@pytest.mark.parametrize(
    ("several", "anchors"),
    [
        ((fh.Sensor("first", noise=1.0),), ("second",)),
        ((fh.Sensor("both", noise=1.0), fh.Sensor("first", noise=1.0)), ("first",)),
        ((fh.Sensor("third", noise=1.0),), ("third", "first")),
        ((fh.Sensor("both", noise=1.0, delay=0.03),), ("delay", 0.02, 0.03)),
        ((fh.Sensor("both", noise=1.0, period=0.01),), ("period", 0.02, 0.01)),
        ((fh.Sensor("both"),), ("definite",)),
        ("first", ("sensor",)),
    ],
)
def test_sensors_that_do_not_fit_are_refused(several, anchors):
    case = LinearCase(3, 2, 2)
    with refused_with(InvalidInput, *anchors):
        UnscentedKalmanFilter(**case.arguments(plant=linear(case), measurement_noise=None, sensors=several))


def test_noise_is_stated_once_and_a_late_output_has_no_input():
    case = LinearCase(3, 2, 2)
    with refused_with(InvalidInput, "measurement_noise", "sensors"):
        UnscentedKalmanFilter(**case.arguments(plant=linear(case), sensors=sensors()))
    plant = fh.Plant(lambda x, u, d, p: -x + u, lambda x, u, p: x + u, ("a",), ("u",), outputs=("seen",))
    with refused_with(InvalidInput, "seen", "delay"):
        UnscentedKalmanFilter(
            plant, PERIOD, 1e-4, None, [0.0], 1.0, sensors=fh.Sensor("seen", noise=1.0, delay=PERIOD)
        )
