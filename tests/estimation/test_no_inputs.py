"""Plants without inputs: what is tracked, and not driven."""

from __future__ import annotations

import copy
import pickle
from dataclasses import replace

import numpy as np
import pytest
from tests.builders import pairs
from tests.refusals import refused_with

import flexhinf as fh
from flexhinf.errors import InvalidInput
from flexhinf.estimation import ExtendedKalmanFilter, UnscentedKalmanFilter

# Kernels that run once each: half of the time.
pytestmark = pytest.mark.usefixtures("unoptimised")

PERIOD, COUNT = 0.1, 240
FILTERS = pytest.mark.parametrize(
    ("kind", "form", "sampled"),
    pairs([UnscentedKalmanFilter, ExtendedKalmanFilter], ["covariance", "square_root"], [True, False]),
)


def swung(x, u, d, p):
    return np.array([x[0] + PERIOD * x[1], x[1] - PERIOD * p.pull * np.sin(x[0])])


def swinging(x, u, d, p):
    return np.array([x[1], -p.pull * np.sin(x[0])])


def target(sampled, inputs=()):
    seen = {"states": ("angle", "speed"), "inputs": inputs, "outputs": ("seen",), "parameters": {"pull": 1.2}}
    flow = swung if sampled else swinging
    return fh.Plant(flow, lambda x, u, p: np.sin(x[:1]), **seen, sampled=sampled)


def tracker(plant, kind=UnscentedKalmanFilter, **others):
    return kind(plant, PERIOD, [1e-6, 1e-4], 1e-3, [0.5, 0.0], [0.1, 0.1], **others)


@pytest.fixture(scope="module")
def seen():
    y = np.sin(0.6 * np.cos(1.1 * PERIOD * np.arange(COUNT))) + 0.03 * np.random.default_rng(2).normal(
        size=COUNT
    )
    y[50:55] = np.nan
    return y[:, None]


@pytest.mark.quick_cases(1)
@FILTERS
def test_it_is_the_filter_of_a_plant_with_an_unused_input(seen, kind, form, sampled):
    alone, other = (
        tracker(target(sampled), kind, form=form),
        tracker(target(sampled, ("u",)), kind, form=form),
    )
    estimates = []
    for y in seen:
        for each, u in ((alone, ()), (other, (0.0,))):
            each.correct(y)
            estimates.append(each.mean)
            each.predict(*u)
    assert alone._compiled is not None
    np.testing.assert_array_equal(estimates[::2], estimates[1::2])
    np.testing.assert_array_equal(alone.covariance, other.covariance)
    for restored in (pickle.loads(pickle.dumps(alone)), copy.deepcopy(alone)):
        restored.predict()
        assert restored.mean.shape == (2,)


@pytest.mark.ci("filters and smooths logs four times")
@FILTERS
def test_over_a_log(seen, kind, form, sampled):
    times = PERIOD * np.arange(COUNT)
    alone, other = (
        tracker(target(sampled), kind, form=form),
        tracker(target(sampled, ("u",)), kind, form=form),
    )
    wanted = fh.filter_log(other, (times, np.zeros(COUNT), seen), smooth=True)
    for log in ((times, None, seen), fh.Log(times, None, seen), fh.Log(times, np.zeros((COUNT, 0)), seen)[:]):
        data = fh.filter_log(alone, log, smooth=True)
        for name in ("estimate", "smoothed", "smoothed_standard_deviation", "nis"):
            np.testing.assert_array_equal(data[name].values, wanted[name].values)
    assert fh.consistency(data).nis.mean == fh.consistency(wanted).nis.mean
    assert fh.diagnose(alone, seen[:20]) == ()


@pytest.mark.ci("identifies a parameter twice")
def test_from_a_file_without_settings_and_identified(seen, tmp_path):
    rows = [f"{PERIOD * k:.9g},{y:.17g}" for k, y in enumerate(seen[:, 0])]
    path = tmp_path / "log.csv"
    path.write_text("time,seen\n" + "\n".join(rows) + "\n", encoding="utf-8")
    plant = target(False)
    log = fh.read_log(path, plant, hold_inputs=True)
    assert log.inputs.shape == (COUNT, 0)
    assert np.isfinite(fh.filter_log(plant, log)["estimate"].values).all()
    found = fh.identify(plant, log, ["pull"])
    same = fh.identify(target(False, ("u",)), fh.Log(log.times, np.zeros((COUNT, 1)), log.outputs), ["pull"])
    assert found.values["pull"] == pytest.approx(same.values["pull"], rel=0.05)


def test_other_estimators_and_more_states():
    plain = replace(target(False), output=lambda x, u, p: x[:1])
    observer = fh.OutputInjectionObserver(plain, PERIOD, 1e-4, 1e-3, [0.5, 0.0], 0.1)
    observer.correct([0.1])
    observer.predict()
    assert np.isfinite(observer.mean).all()
    for plant in (target(True), target(False)):
        wider = tracker(plant).plant.augmented(parameters=("pull",))
        estimator = ExtendedKalmanFilter(wider, PERIOD, 1e-6, 1e-3, [0.5, 0.0, 1.0], 0.1)
        estimator.predict()
        assert estimator.mean.shape == (3,)


def test_what_needs_an_input_is_refused():
    with refused_with(InvalidInput, "inputs=()"):
        target(False).with_objective({"angle": 1.0})
    with refused_with(InvalidInput, "states=(...)"):
        fh.Plant(swung, lambda x, u, p: x, states=(), inputs=())
    with refused_with(InvalidInput, "predict()", 1.5):
        tracker(target(True)).predict(1.5)
    with refused_with(InvalidInput, "torque", "None"):
        tracker(target(True, ("torque",))).predict()
    with refused_with(InvalidInput, "inputs", "(240, 0)", "(240,)", "None"):
        fh.filter_log(tracker(target(True)), (PERIOD * np.arange(COUNT), np.zeros(COUNT), np.zeros(COUNT)))


@pytest.mark.parametrize("kind", [UnscentedKalmanFilter, ExtendedKalmanFilter])
def test_a_late_sensor_of_what_nothing_drives(kind):
    """As with an input that does nothing."""
    late = fh.Sensor("seen", delay=3 * PERIOD, noise=0.03)
    alone, driven = (
        kind(target(True, inputs), PERIOD, [1e-6, 1e-4], None, [0.5, 0.0], [0.1, 0.1], sensors=late)
        for inputs in ((), ("unused",))
    )
    for y in (0.4, 0.38, 0.35):
        for filter, u in ((alone, None), (driven, [0.0])):
            filter.correct([y])
            filter.predict(u)
    np.testing.assert_array_equal(alone.mean, driven.mean)
