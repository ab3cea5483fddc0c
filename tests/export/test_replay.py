"""The exported C answers what the controller in Python answers, whatever it is given."""

from __future__ import annotations

import math
import subprocess
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pytest

import flexhinf as fh
from flexhinf.baselines import FeedbackLinearisation, MotorPD, lqr
from flexhinf.errors import NumericalFailure
from flexhinf.export.recording import record

ARM = fh.paper_arm()
NOISES = (1e-7, 1e-4, np.zeros(4), 1e-4)
PROBLEM = ARM.problem()


def ukf(**options: Any) -> fh.UnscentedKalmanFilter:
    return fh.UnscentedKalmanFilter(ARM.plant(), 1e-3, *NOISES, **options)


def cubic() -> Any:
    return fh.solve_hji(PROBLEM, gamma=math.inf, degree=4)


def schedule() -> fh.Schedule:
    return fh.Schedule([fh.linear_law(ARM.problem(pose=at), gamma=math.inf) for at in (0.0, 0.8)])


CONTROLLERS: dict[str, Callable[[], fh.Controller]] = {
    "cubic, ukf": lambda: fh.Controller(cubic(), ukf(), 1e-3, 48.0),
    "linear, ekf, limits": lambda: fh.Controller(
        fh.linear_law(PROBLEM, gamma=math.inf), fh.ExtendedKalmanFilter(ARM.plant(), 1e-3, *NOISES), 1e-3, 12.0,
        command_range=0.4, command_rate=2.0, input_rate=3e3, integral_dead_zone=1e-3,
    ),
    "state": lambda: fh.Controller(cubic(), None, 1e-3, 48.0, start="bumpless"),
    "schedule": lambda: fh.Controller(schedule(), ukf(), 1e-3, 48.0),
    "moving": lambda: fh.Controller(lqr(PROBLEM), ukf(), 1e-3, 48.0, moving=True),
    "observer": lambda: fh.Controller(
        MotorPD.tuned(PROBLEM, 5.0, 0.7), fh.OutputInjectionObserver(ARM.plant(), 1e-3, *NOISES[:3]), 1e-3, 48.0
    ),
    "flatness, bounded": lambda: fh.Controller(
        FeedbackLinearisation.tuned(PROBLEM, 3.0), ukf(bounds={"link_position": (-3.0, 3.0)}), 1e-3, 48.0
    ),
}  # fmt: skip


def answers(controller: fh.Controller, y: np.ndarray, r: np.ndarray, measured: np.ndarray) -> np.ndarray:
    """Inputs of the controller in Python; where a sample is refused, the last good one."""
    fresh = controller.fresh()
    held, missing, inputs = fresh.input_before(), 0, []
    for k in range(len(y)):
        there = np.isfinite(y[k])
        some = measured[k] and (there.any() if controller.estimator else there.all())
        if some:  # a bad command leaves its measurement unused
            missing = 0 if np.isfinite(r[k]).all() else min(missing + 1, 10)
        else:
            missing += not measured[k] or controller.estimator is not None
        try:
            if some or (missing <= 10 and controller.estimator is not None):
                held = fresh.step(
                    np.where(there, y[k], np.nan) if some else None, r[k] if r.shape[1] else None
                )
        except NumericalFailure:
            pass
        inputs.append(held)
    return np.array(inputs)


def hostile(controller: fh.Controller, samples: int, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Measurements with outliers over twenty decades, that are not finite, or missing for a while."""
    rng = np.random.default_rng(seed)
    run = record(controller, samples, interrupted=False)
    y, r = run.y.copy(), run.r[:, : len(controller.commanded)].copy()
    wild = rng.random(samples) < 0.03
    y[wild] *= 10.0 ** rng.uniform(-1, 20, (wild.sum(), 1))
    for array, share in ((y, 0.03), (r, 0.01)):
        for k in np.flatnonzero(rng.random(samples) < share):
            if array.shape[1]:
                array[k, rng.integers(array.shape[1])] = rng.choice([np.nan, np.inf, -np.inf])
    measured = np.ones(samples, dtype=int)
    for k in np.flatnonzero(rng.random(samples) < 0.01):
        measured[k : k + rng.integers(1, 25)] = 0
    return y, r, measured


@pytest.fixture(scope="module")
def exported(build: Callable[..., Any]) -> Callable[[str], tuple[fh.Controller, Any]]:
    """A controller by its name, and its compiled code in `double`."""

    @cache
    def made(name: str) -> tuple[fh.Controller, Any]:
        controller = CONTROLLERS[name]()
        return controller, build(controller)

    return made


@pytest.mark.ci("compiles an unscented filter, in Python and in C")
@pytest.mark.quick_cases(1)
@pytest.mark.oracle
@pytest.mark.parametrize("name", CONTROLLERS)
def test_a_recorded_loop_comes_out_the_same(name: str, exported: Callable[[str], Any]) -> None:
    controller, compiled = exported(name)
    run = record(controller)
    measured = np.array([code != "PREDICTED" for code in run.codes])
    u, x, codes = compiled.replay(run.y, run.r[:, : len(controller.commanded)], measured, *_sizes(controller))
    np.testing.assert_array_equal(u, run.u)
    np.testing.assert_array_equal(x, run.estimate)
    assert [int(code) for code in codes] == [
        {"OK": 0, "PREDICTED": 5, "BAD_MEASUREMENT": 1}[c] for c in run.codes
    ]


@pytest.mark.ci("3,000 samples of seven controllers, in Python and in C")
@pytest.mark.oracle
@pytest.mark.parametrize("name", CONTROLLERS)
def test_hostile_samples_are_answered_as_in_python(name: str, exported: Callable[[str], Any]) -> None:
    controller, compiled = exported(name)
    y, r, measured = hostile(controller, 3000, seed=1)
    u, _, codes = compiled.replay(y, r, measured, *_sizes(controller))
    expected = answers(controller, y, r, measured)
    assert np.isfinite(u).all()
    assert np.abs(u).max() <= controller.limits.upper.max()
    assert {5 if controller.estimator else 1, 6} | ({2} if controller.commanded else set()) <= set(
        codes.tolist()
    )
    np.testing.assert_array_equal(u, expected)


@pytest.mark.ci("two exports with their test vectors")
@pytest.mark.parametrize("real", ["float", "double"])
def test_the_test_vector_passes(real: str, build: Callable[..., Any], compiler: str) -> None:
    compiled = build(CONTROLLERS["linear, ekf, limits"](), real, whole=True)
    done = subprocess.run(
        ["make", "-s", f"CC={compiler}", "test"],
        cwd=compiled.folder,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr + done.stdout
    assert done.stderr == ""
    assert "passed" in done.stdout


def _sizes(controller: fh.Controller) -> tuple[int, int]:
    return len(controller.law.input_names), len(controller.states)
