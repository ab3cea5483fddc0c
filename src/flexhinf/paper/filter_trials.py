"""Two filters on the same data, many times: Eq. (9) itself is simulated, with its process and measurement noise.

The truth moves by the filters' own F, so model and noises match unless a parameter is changed on purpose. Both
filters get the same true starts, noises and inputs, and the input does not depend on the estimates: differences
within a pair are the filters' alone.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from flexhinf.codegen import Buffer, Call, Kernel, Program, Repeat, Slice, compile_program
from flexhinf.estimation import ExtendedKalmanFilter, RecursiveFilter, UnscentedKalmanFilter
from flexhinf.loop.shared import share
from flexhinf.loop.signals.sampling import standard_normal
from flexhinf.paper.loop_setup import in_two_threads
from flexhinf.plant import Plant
from flexhinf.scalars import cholesky, solve_lower, trace


@dataclass(frozen=True)
class Trial:
    """What two filters are compared on.

    Attributes
    ----------
    model : Plant
        What both filters believe in, with its sensors.
    period : float
        s.
    process_noise : float
        q of R^v = q I, of the truth and of the filters.
    measurement_noise : (p,) tuple
        Variances R^n, likewise.
    initial : (n,) tuple
        Standard deviations of the true start about the filters' initial mean; their P0 is the same.
    changes : mapping
        Parameters of the truth that differ from the model's.
    """

    name: str
    model: Plant
    period: float
    process_noise: float
    measurement_noise: tuple[float, ...]
    initial: tuple[float, ...]
    changes: Mapping[str, float]

    def filters(self) -> tuple[RecursiveFilter, RecursiveFilter]:
        """(UKF, EKF) from the mean zero."""
        start, p0 = np.zeros(self.model.n), np.array(self.initial) ** 2
        both = (UnscentedKalmanFilter, ExtendedKalmanFilter)
        noises = (self.process_noise, np.array(self.measurement_noise))
        ukf, ekf = (kind(self.model, self.period, *noises, start, p0) for kind in both)
        return ukf, ekf


@dataclass(frozen=True)
class Scores:
    """Errors of one filter in R runs.

    Attributes
    ----------
    squared : (R, n) array
        Mean squared error of each state over a run; NaN for a filter that failed.
    mean : (R, n) array
        Mean error of each state over a run.
    nees : (R,) array
        Mean of eᵀ P⁻¹ e over a run; n where the filter's covariance is right.
    """

    squared: np.ndarray
    mean: np.ndarray
    nees: np.ndarray


def run_trial(trial: Trial, inputs: np.ndarray, runs: int, seed: int) -> tuple[Scores, Scores]:
    """(UKF's, EKF's) scores on the same data; inputs (steps, m), held between samples."""
    filters = trial.filters()
    kernels = [_kernel(f) for f in filters]
    tables = [_numbers(trial, f) for f in filters]
    n, p = trial.model.n, len(trial.model.outputs)
    steps = len(inputs)

    def one(k: int) -> list[np.ndarray]:
        normal = standard_normal(seed, steps + 1, n + p, sample=k)
        data = {
            "inputs": inputs.ravel(),
            "moves": (np.sqrt(trial.process_noise) * normal[1:, :n]).ravel(),
            "noise": (np.sqrt(np.array(trial.measurement_noise)) * normal[1:, n:]).ravel(),
        }
        summaries = []
        for filter, kernel, table in zip(filters, kernels, tables, strict=True):
            recorded = np.zeros((steps, n + 1))
            arrays = {
                **data,
                **table,
                "x": np.array(trial.initial) * normal[0, :n],
                "recorded": recorded.ravel(),
            }
            arrays |= {"belief": np.concatenate([np.ravel(part) for part in filter.initial])}
            kernel.run(arrays, {"steps": steps})
            errors = recorded[:, :n]
            summaries.append(np.concatenate([(errors**2).mean(0), errors.mean(0), [recorded[:, n].mean()]]))
        return summaries

    found = np.array(in_two_threads(one, list(range(runs))))
    ukf, ekf = (Scores(found[:, i, :n], found[:, i, n : 2 * n], found[:, i, -1]) for i in (0, 1))
    return ukf, ekf


def _numbers(trial: Trial, filter: RecursiveFilter) -> dict[str, np.ndarray]:
    """What a run takes in besides the data."""
    table = trial.model.parameters
    return {
        "truth": table.replaced(dict(trial.changes)).vector(),
        "model": table.vector(),
        "noises": np.concatenate([filter.process_noise.ravel(), filter.measurement_noise.ravel()]),
    }


def _kernel(filter: RecursiveFilter) -> Kernel:
    key = ("filter trial", filter.estimator_key, filter.plant.code_key)
    return share(key, lambda: compile_program(_program(filter)))


def _program(filter: RecursiveFilter) -> Program:
    """Measure, correct, compare with the truth, move both; one turn per sample."""
    plant = filter.plant
    n, m, p = plant.n, len(plant.inputs), len(plant.outputs)
    named, size = plant.parameters.named, plant.parameters.size

    def step(
        x: Any, belief: Any, u: Any, move: Any, noise: Any, truth: Any, model: Any, noises: Any
    ) -> tuple[Any, ...]:
        q, r = noises[: n * n].reshape(n, n), noises[n * n :].reshape(p, p)
        y = plant.evaluate_output(x, u, truth) + noise
        prior = type(filter.initial)(belief[:n], belief[n:].reshape(n, n))
        posterior = filter.measurement_update(prior, y, u, named(model), r)
        error = posterior.mean - x
        white = solve_lower(cholesky(posterior.covariance), error)
        later = filter.time_update(posterior, u, named(model), q)
        moved = filter.transition(x, u, named(truth)) + move
        after = np.concatenate([np.asarray(later.mean), np.asarray(later.covariance).ravel()])
        return moved, after, np.concatenate([error, [white @ white]])

    sizes = {"x": n, "belief": n + n * n, "inputs": m, "moves": n, "noise": p}
    sizes |= {"truth": size, "model": size, "noises": n * n + p * p}
    function = trace(step, *sizes.values(), name="filter_trial", names=list(sizes))
    rows = ("inputs", "moves", "noise")
    slices = {k: Slice(k, size=v, strides=(v if k in rows else 0,)) for k, v in sizes.items()}
    recorded = Slice("recorded", size=n + 1, strides=(n + 1,))
    buffers = [
        Buffer(k, None if k in rows else v, "state" if k in ("x", "belief") else "in")
        for k, v in sizes.items()
    ]
    call = Call(function, tuple(slices.values()), (slices["x"], slices["belief"], recorded))
    return Program(
        "filter_trial", (*buffers, Buffer("recorded", None, "out")), (Repeat("steps", (call,)),), ("steps",)
    )
