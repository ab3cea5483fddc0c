"""Estimators composed of pieces, against the Kalman filter and against their own text."""

import numpy as np
import pytest

from flexhinf.codegen import Block, Buffer, Composer, Program, Slice, compile_program
from flexhinf.estimation import ExtendedKalmanFilter, UnscentedKalmanFilter

BOTH = pytest.mark.parametrize("kind", [UnscentedKalmanFilter, ExtendedKalmanFilter])


def composed_step(estimator):
    """``step(mean, covariance, y, u)`` → corrected with y, then predicted with u: one compiled program."""
    plant, n = estimator.plant, estimator.plant.n
    run, p, m = Composer(), len(plant.outputs), len(plant.inputs)
    shapes = {
        "mean": (n,), "covariance": (n, n), "y": (p,), "u": (m,), "p": (plant.parameters.size,),
        "q": (n, n), "r": (p, p),
    }  # fmt: skip
    blocks = {name: Block(Slice(name, 0, int(np.prod(shape))), shape) for name, shape in shapes.items()}
    belief = type(estimator.initial)(blocks["mean"], blocks["covariance"])
    belief = estimator.measurement_update_on(run, belief, blocks["y"], blocks["u"], blocks["p"], blocks["r"])
    belief = estimator.time_update_on(run, belief, blocks["u"], blocks["p"], blocks["q"])
    run.copy(belief.mean, blocks["mean"])
    run.copy(belief.covariance, blocks["covariance"])
    roles = {name: "state" if name in ("mean", "covariance") else "in" for name in shapes}
    buffers = [Buffer(name, blocks[name].size, roles[name]) for name in shapes]
    kernel = compile_program(Program("filter", (*buffers, *run.buffers), tuple(run.body)))
    assert kernel.compiled
    fixed = {"p": plant.parameters.vector(), "q": estimator.process_noise, "r": estimator.measurement_noise}

    def step(mean, covariance, y, u):
        arrays = {"mean": mean.copy(), "covariance": covariance.copy(), "y": y, "u": u, **fixed}
        assert kernel.run(arrays).fine
        return arrays["mean"], arrays["covariance"]

    return step


@pytest.mark.oracle
@BOTH
@pytest.mark.parametrize(("n", "p"), [(3, 1), (9, 4), (28, 7), (33, 8)])
def test_on_a_linear_plant_they_are_the_kalman_filter(kalman, kind, n, p):
    case = kalman.case(n, 2, p, seed=n, scale=1e-2)
    estimator = kind(**case.arguments())
    step, (f, g) = composed_step(estimator), case.map(estimator.sub_steps)
    expected = mean, covariance = case.mean, case.p0
    for _ in range(5):
        y, u = 1e-2 * case.rng.normal(size=p), case.rng.normal(size=2)
        mean, covariance = step(mean, covariance, y, u)
        np.testing.assert_array_equal(covariance, covariance.T)
        expected = kalman.correct(*expected, case.c, y, case.r)
        expected = kalman.predict(*expected, f, g, u, case.q)
        assert kalman.relative(mean, covariance, *expected) < 1e-10


@pytest.mark.oracle
@BOTH
def test_composed_they_are_their_text_on_floats(kalman, kind):
    case = kalman.case(12, 2, 3, seed=4)
    estimator = kind(**case.arguments(period=0.3))
    assert estimator.sub_steps > 2
    step, (mean, covariance) = composed_step(estimator), (case.mean, case.p0)
    for _ in range(3):
        y, u = case.rng.normal(size=3), case.rng.normal(size=2)
        mean, covariance = step(mean, covariance, y, u)
        belief = estimator.measurement_update(
            estimator._belief, y, u, estimator._parameters, estimator.measurement_noise
        )
        estimator._belief = estimator.time_update(belief, u, estimator._parameters, estimator.process_noise)
        assert kalman.relative(mean, covariance, *estimator._belief) < 1e-11
