"""An estimate in doubt is said and counted by every controller of a Kalman filter, in Python and compiled loops."""

from __future__ import annotations

import pickle
from functools import partial

import numpy as np
import pytest
from tests.builders import still

import flexhinf as fh
from flexhinf.estimation import ConstantGainFilter, linear_model, stationary_gain

# Kernels that run once each: half of the time.
pytestmark = pytest.mark.usefixtures("unoptimised")

EPS = np.finfo(float).eps
KICKS = 5, 11, 12, 30


def twin(bent=0.0):
    """Two states of which the outputs see nearly the same; with `bent`, the second output is no line."""
    return fh.Plant(
        lambda x, u, d, p: np.array([u[0] - 0.5 * x[0] + d[0], -0.3 * x[1] + d[1]]),
        lambda x, u, p: np.array([x[0] + x[1], x[0] + p.c * x[1] + bent * x[1] * x[1]]),
        ("a", "b"), ("u",), ("push", "kick"), {"c": 1.0 + 1e-7}, ("y1", "y2"),
    )  # fmt: skip


KINDS = {
    "ukf": fh.UnscentedKalmanFilter,
    "ekf": fh.ExtendedKalmanFilter,
    "ukf, bent": partial(fh.UnscentedKalmanFilter, twin(1e-9)),
    "ekf, bent": partial(fh.ExtendedKalmanFilter, twin(1e-9)),
}


def made(kind, **options):
    """A filter that loses its digits where an innovation is a million standard deviations."""
    make = KINDS[kind] if "bent" in kind else partial(KINDS[kind], twin())
    return make(0.01, 1e-16, 1e-30, [0.0, 0.0], 1e-16, form="square_root", **options)


def measured(count=40):
    """Measurements of a state at rest, of which some are kicked, one element and a whole sample are missing."""
    rng = np.random.default_rng(2)
    y = 1e-9 * rng.normal(size=(count, 1)) * np.ones(2)
    for k in KICKS:
        y[k] += 1e-2
    y[7, 1] = np.nan
    y[20] = np.nan
    return y


def lost_digits(root, slope, noise, innovation):
    """The rule by NumPy's own factorisation: standard deviations by which rounding may move the mean."""
    factor = np.linalg.qr(np.concatenate([root @ slope.T, np.linalg.cholesky(noise).T]), mode="r")
    scale = np.abs(slope) @ np.sqrt((root * root).sum(axis=0)) + np.sqrt(np.diag(noise))
    white = np.linalg.solve(factor.T, innovation)
    return EPS / np.min(np.abs(np.diag(factor)) / scale) * max(1.0, np.abs(white).max())


@pytest.mark.quick_cases(1)
@pytest.mark.oracle
@pytest.mark.parametrize("pieces", [False, True])
@pytest.mark.parametrize("kind", KINDS)
def test_a_controller_says_and_counts_what_the_rule_says(kind, pieces):
    filter = made(kind)
    controller = fh.Controller(still(filter.plant), filter, 0.01, latency=0)
    controller = controller.in_pieces() if pieces else controller
    said, expected, found = [], [], []
    for k, y in enumerate(measured()):
        there, prior = np.isfinite(y), filter._belief
        before = [entry for entry in filter.diagnosis if entry.kind == "digits"]
        if there.any():
            slope = filter.measured(prior.mean, np.zeros(1), filter.plant.parameters.vector())[1][there]
            seen = np.asarray(
                filter.plant.evaluate_output(prior.mean, np.zeros(1), filter.plant.parameters.vector())
            )
            noise = filter.measurement_noise[np.ix_(there, there)]
            innovation = y[there] - seen.astype(float)[there]
            expected.append(lost_digits(prior.root, slope, noise, innovation) > 1e-3)
        else:
            expected.append(False)
        filter.correct(y)
        found.append([entry for entry in filter.diagnosis if entry.kind == "digits"] != before)
        filter.predict([0.0])
        controller.step(y)
        said.append(bool(controller.status & fh.Status.DOUBTFUL_ESTIMATE))
        assert controller.doubtful_samples == sum(said), k
    assert said == expected == found
    back = {k + 1 for k in KICKS}
    assert set(KICKS) - back <= set(np.flatnonzero(said).tolist()) <= set(KICKS) | back
    again = pickle.loads(pickle.dumps(controller))
    assert again.doubtful_samples == sum(said)
    controller.reset()
    assert (controller.doubtful_samples, controller.status) == (0, fh.Status(0))


@pytest.mark.parametrize("kind", [fh.UnscentedKalmanFilter, fh.ExtendedKalmanFilter])
def test_deviations_whose_squares_are_no_floats_are_in_doubt_and_go_on(kind):
    """0 · ∞ of a state that is not measured is no reason to stop."""
    plant = fh.Plant(
        lambda x, u, d, p: np.array([u[0] - x[0], -x[1]]),
        lambda x, u, p: x[:1],
        ("a", "b"),
        ("u",),
        outputs=("a",),
    )
    filter = kind(plant, 0.01, 0.0, 1.0, [0.0, 0.0], 1.0, form="square_root")
    filter._belief = filter._belief._replace(root=np.diag([1.0, 1e160]))
    filter.correct([0.1])
    assert filter.mean[0] == pytest.approx(0.05)
    assert [entry.kind for entry in filter.diagnosis] == ["digits"]


def test_what_a_gate_rejects_is_not_in_doubt():
    filter = made("ekf", gate=0.9999)
    controller = fh.Controller(still(filter.plant), filter, 0.01)
    for y in measured()[:10]:
        controller.step(y)
    assert controller.doubtful_samples == 0
    assert controller.rejected.tolist() == [1, 1]


@pytest.mark.quick_cases(2)
@pytest.mark.parametrize("kind", [fh.UnscentedKalmanFilter, fh.ExtendedKalmanFilter])
@pytest.mark.parametrize("bent", [0.0, 1e-3])
def test_a_repaired_covariance_is_in_doubt(kind, bent):
    """Two states that are known to be alike: P is singular until process noise parts them, after one correction and one
    prediction."""
    alike = [[1.0, 1.0], [1.0, 1.0]]
    for p0, noise, count in ((alike, 0.0, 3), (alike, 1e-2, 2), ([1.0, 0.0], 0.0, 0), ([1.0, 1.0], 0.0, 0)):
        filter = kind(twin(bent), 0.01, noise, 1.0, [0.0, 0.0], p0, form="covariance")
        controller = fh.Controller(still(filter.plant), filter, 0.01)
        for _ in range(3):
            controller.step([1e-2, 1e-2])
        assert controller.doubtful_samples == count


def test_estimators_that_do_not_say_cost_nothing():
    filter = made("ekf")
    model = linear_model(filter, np.zeros(2), np.zeros(1))
    gain = stationary_gain(model, 1e-6 * np.eye(2), np.eye(2))
    for estimator in (ConstantGainFilter(filter, gain), None):
        controller = fh.Controller(still(filter.plant), estimator, 0.01)
        assert "doubt" not in controller.memory.parts
        assert "rcond_limit" not in controller.data.parts
        assert (controller.doubtful_samples, controller.status) == (0, fh.Status(0))


@pytest.mark.quick_cases(1)
@pytest.mark.oracle
@pytest.mark.parametrize("lanes", [1, 8])
def test_loops_count_what_their_steps_say(lanes, tmp_path):
    """Kicks of a disturbance, alone and in lanes: the count of the controller that is stepped through the outputs."""
    filter = made("ekf")
    controller = fh.Controller(still(filter.plant), filter, 0.01)
    loop = fh.Loop(filter.plant, controller)
    options = {
        "disturbance": {"kick": fh.Samples([0.0, 0.095, 0.0951, 0.105, 0.1051], [0.0, 0.0, 1.0, 1.0, 0.0])},
        "duration": 0.5,
    }  # fmt: skip
    run, stepped = loop.run(**options), controller.fresh()
    for y in run.signals["output"]:
        stepped.step(y)
    assert run.doubtful_samples == stepped.doubtful_samples > 0
    assert run.data.attrs["doubtful_samples"] == str(run.doubtful_samples)
    run.save(tmp_path / "run.nc")
    ensemble = loop.ensemble(**options)
    result = ensemble.run(np.ones((3, 1)) * (1.0 + 1e-7), [0, 1, 0], lanes=lanes)
    assert result.doubtful_samples.tolist()[::2] == [run.doubtful_samples] * 2
    singles = list(ensemble.trajectories(np.ones((3, 1)) * (1.0 + 1e-7), [0, 1, 0]))
    assert result.doubtful_samples.tolist() == [one.doubtful_samples for one in singles]


@pytest.mark.oracle
def test_a_campaign_has_the_count_as_a_column():
    from flexhinf.campaign import Campaign, run_batch

    filter = made("ekf")
    loop = fh.Loop(filter.plant, fh.Controller(still(filter.plant), filter, 0.01))
    kick = {"kick": fh.Step(1.0, at=0.1)}
    for metrics in (None, "doubtful_samples"):
        campaign = Campaign(
            loop, lambda rng: {}, samples=2, metrics=metrics, options={"disturbance": kick, "duration": 0.2},
        )  # fmt: skip
        table = run_batch(campaign, 0)
        assert table["doubtful_samples"].min() >= 1.0
